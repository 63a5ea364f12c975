"""Readers under mutated bytes: whatever is in a file, only a ClutterGenError may come out.

`python -m tests.helpers.fuzzing SECONDS SEED [READER...]` looks for crashes, each reader so long, and
adds what it finds to `tests/corpus`, which `test_fuzz.py` tries again each time.
"""

from __future__ import annotations

import faulthandler
import gzip
import hashlib
import json
import random
import re
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import trimesh
from PIL import Image

from cluttergen_jax import bank_reader
from cluttergen_jax.assets.object_files import read_object, write_object
from cluttergen_jax.assets.pool import Pool, read_pool, write_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.assets.support_file import read_support, write_support
from cluttergen_jax.config import ContactConfig, StabilityConfig, VerifyConfig
from cluttergen_jax.downstream.robot import description
from cluttergen_jax.downstream.robot.description import read_robot
from cluttergen_jax.errors import BankError, ClutterGenError
from cluttergen_jax.generation import repair
from cluttergen_jax.generation.layouts import read_layout, read_layout_json
from cluttergen_jax.importing.readers import find_sources, read_shape, sets
from cluttergen_jax.importing.settings import read_settings
from cluttergen_jax.judging.scene_files import load_model, read_model, read_starts
from cluttergen_jax.judging.verify import verify_scene
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.ppo.checkpoint import read_policy, save_policy
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.scene.bank.stats import stats_of
from cluttergen_jax.scene.export.mjcf import scene_xml
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene
from cluttergen_jax.sensing.camera import parse_cameras
from tests.helpers import banks, shiny
from tests.helpers.fuzzed_files import OWN, plain, without_seal
from tests.helpers.gltf import skinned
from tests.helpers.worlds import trio

CORPUS = Path(__file__).parents[1] / "corpus"
ROBOTS = Path(description.__file__).parent / "robots"
LIKE = {"params": {"actor": {"kernel": np.zeros((4, 3), np.float32)}}}
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]{2,}")
_NASTY = (
    b"nan",
    b"inf",
    b"-inf",
    b"-1",
    b"0",
    b"1e999",
    b"1e-320",
    b"99999999999999999999",
    b"4294967295",
)
_NASTY += (
    b"1000000000000",
    b"null",
    b'""',
    b"[]",
    b"{}",
    b"true",
    b"2147483648",
    b"x",
    b"",
    b"1 2",
    b"\xff\xfe",
    b"\x00",
)


@dataclass(frozen=True)
class Reader:
    """One reader, and a file that it reads well.

    Attributes:
      make: writes a sound folder. file: the file in it that is mutated. read: reads the folder.
      signed: signs a mutated JSON record anew, so that more than its digest is tried.
      mark: bytes that tell of a checksum, by which a mutant that still has them is known to be another: it is
        refused, or read as the very same value. None for readers of other programs' files; empty where
        whatever is changed is noticed.
    """

    make: Callable[[Path], object]
    file: str
    read: Callable[[Path], object]
    signed: Callable[[bytes], bytes] | None = None
    mark: bytes | None = None


def mutated(data: bytes, draw: random.Random) -> bytes:
    """One to four small accidents."""
    for _ in range(draw.randint(1, 4)):
        data = draw.choice(_ACCIDENTS)(data, draw)
    return data


def _flip(data: bytes, draw: random.Random) -> bytes:
    if not data:
        return data
    place = draw.randrange(len(data))
    return data[:place] + bytes([data[place] ^ (1 << draw.randrange(8))]) + data[place + 1 :]


def _noise(data: bytes, draw: random.Random) -> bytes:
    place = draw.randrange(len(data) + 1)
    return (
        data[:place]
        + draw.randbytes(draw.choice((1, 4, 8)))
        + data[place + draw.choice((0, 1, 4, 8)) :]
    )


def _cut(data: bytes, draw: random.Random) -> bytes:
    first, last = sorted(draw.randrange(len(data) + 1) for _ in range(2))
    return data[:first] + (data[min(last, first + draw.choice((1, 5, 50, 10**9))) :])


def _truncate(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data) + 1)]


def _repeat(data: bytes, draw: random.Random) -> bytes:
    first, last = sorted(draw.randrange(len(data) + 1) for _ in range(2))
    return data[:last] + data[first:]


def _token(pattern: re.Pattern[bytes]) -> Callable[[bytes, random.Random], bytes]:
    def change(data: bytes, draw: random.Random) -> bytes:
        found = list(pattern.finditer(data))
        if not found:
            return data
        one = draw.choice(found)
        other = draw.choice(found)
        new = draw.choice((draw.choice(_NASTY), other[0]))
        return data[: one.start()] + new + data[one.end() :]

    return change


_ACCIDENTS = (_flip, _noise, _cut, _truncate, _repeat, *[_token(_NUMBER)] * 4, *[_token(_WORD)] * 2)


def _bank(folder: Path, checksums: bool = True) -> None:
    with banks.writer(folder, 8) as writer:
        writer.write_block(0, banks.rows(0, 8))
    if not checksums:
        block = folder / "scenes-000000.parquet"
        pq.write_table(pq.read_table(block), block, compression="none")
        # What is not the block that was written is refused before it is read.
        record = json.loads((folder / "bank.json").read_bytes())
        del record["files"][block.name]
        (folder / "bank.json").write_bytes(_sign(None)(json.dumps(record).encode()))


def _read_bank(folder: Path) -> None:
    bank = read_bank(folder)
    _ = bank.table
    list(bank.scenes())
    stats_of(bank)
    list(read_scenes(bank))


def _stand_alone(folder: Path) -> None:
    """With the reader that stands alone, whose error is its own."""
    try:
        bank = bank_reader.Bank(folder)
        bank.summary()
        _ = bank.arrays, bank.labels, bank.xml(0, version="3.17")
    except bank_reader.BankError as error:
        raise BankError(error.given) from error


def _values_alone(folder: Path) -> object:
    """All that the reader which stands alone makes of a bank without rules of physics."""
    try:
        bank = bank_reader.Bank(folder)
        return plain([bank.summary(), tuple(bank.arrays), bank.labels, bank.support.record])
    except bank_reader.BankError as error:
        raise BankError(error.given) from error


def _no_digests(folder: Path) -> None:
    """A bank of a scene of which bank.json knows no files."""
    shutil.copytree(CORPUS.parent / "golden" / "bank", folder)


def _sign(separators: tuple[str, str] | None) -> Callable[[bytes], bytes]:
    def sign(data: bytes) -> bytes:
        try:
            record = json.loads(data)
        except (ValueError, RecursionError):
            return data
        if isinstance(record, dict):
            record.pop("hash", None)
            text = json.dumps(record, sort_keys=True, separators=separators)
            record["hash"] = hashlib.sha256(text.encode()).hexdigest()
        return json.dumps(record).encode()

    return sign


def _own(name: str) -> Reader:
    """A reader of a file of our own, with its checksum."""
    make, file, read = OWN[name]
    marks = {".json": b'"sha256"', ".jsonl": b'"sha256"', ".parquet": b"cluttergen_sha256"}
    return Reader(make, file, read, mark=marks.get(Path(file).suffix, b""))


def _old(name: str) -> Reader:
    """The same of an older version, without one."""
    make, file, read = OWN[name]
    return Reader(without_seal(make, file), file, read)


def _policy(folder: Path) -> None:
    save_policy(
        folder, LIKE, {"placement": {"max_attempts": 5, "history_stride": 0}, "network": {}}
    )


def _read_placement(folder: Path) -> object:
    return plain(read_checkpoint(folder).record["placement"])


def _mesh(suffix: str, kind: str = "", **kwargs: object) -> Reader:
    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        data = trimesh.creation.box((0.1, 0.1, 0.2)).export(
            file_type=kind or suffix.strip("."), **kwargs
        )
        (folder / f"thing{suffix}").write_bytes(data if isinstance(data, bytes) else data.encode())

    return Reader(make, f"thing{suffix}", _read_shapes)


def _finished_glb(folder: Path) -> None:
    """A slab with all that a material of glTF says of a finish."""
    look = {"roughnessFactor": 0.1, "metallicFactor": 0.5, "metallicRoughnessTexture": {"index": 1}}
    material = {
        "pbrMetallicRoughness": look,
        "normalTexture": {"index": 0, "scale": 0.5},
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}},
    }
    shiny.write_glb(folder / "slab.glb", material, images=(shiny.bumps(), shiny.gloss()))


def _finished_obj(folder: Path) -> None:
    """A slab with all that MTL says of a finish."""
    lines = ("# Blender", "Ks 1 1 1", "Ns 30", "Pm 0.5", "d 0.5", "norm n.png", "map_Pr n.png")
    shiny.write_obj(folder, *lines, images=[("n.png", shiny.bumps())])


def _read_shapes(folder: Path) -> None:
    for source in find_sources(folder):
        read_shape(source)


def _text(name: str, text: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
        mesh = trimesh.creation.box((0.1, 0.1, 0.2)).export(file_type="obj")
        (folder / "part.obj").write_text(mesh)
        (folder / "label.json").write_text('{"globalScaling": 0.5, "ori_rpy": [0, 0, 1.5]}')

    return make


URDF = """<robot name="thing"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="base"><visual><origin xyz="0 0 0.1" rpy="0 0 0.3"/><geometry>
<mesh filename="part.obj" scale="1 1 1"/></geometry><material name="red"/></visual>
<collision><geometry><box size="0.1 0.1 0.2"/></geometry></collision></link>
<link name="lid"><visual><geometry><cylinder radius="0.05" length="0.1"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><origin xyz="0 0 0.2"/>
<axis xyz="0 1 0"/><limit lower="0.1" upper="1"/></joint></robot>"""

SDF = """<sdf version="1.9"><model name="thing"><pose>0 0 1 0 0 0.3</pose><link name="base">
<pose degrees="true">0 0 0.1 0 0 30</pose><inertial><mass>0.2</mass><inertia><ixx>1e-4</ixx><iyy>1e-4</iyy>
<izz>1e-4</izz></inertia></inertial><visual name="v"><geometry><mesh><uri>part.obj</uri></mesh></geometry>
<material><script><uri>.</uri><name>Red</name></script></material></visual><collision name="c"><geometry><box>
<size>0.1 0.1 0.2</size></box></geometry></collision></link><frame name="f" attached_to="base"/>
<joint name="j" type="revolute"><parent>base</parent><child>lid</child></joint><link name="lid">
<pose relative_to="f">0 0 0.2 0 0 0</pose><visual name="v"><geometry><cylinder><radius>0.05</radius>
<length>0.1</length></cylinder></geometry><transparency>0.2</transparency></visual></link></model></sdf>"""
SCRIPT = "material Base { technique { pass { diffuse 1 0 0 1 } } }\n"
SCRIPT += "material Red : Base\n{\n diffuse 1 0 0\n}\n"


def _sdf(folder: Path) -> None:
    _text("thing.sdf", SDF)(folder)
    (folder / "red.material").write_text(SCRIPT)
    (folder / "model.config").write_text(
        '<model><name>A</name><sdf version="1.9">thing.sdf</sdf></model>'
    )


MJCF = """<mujoco><asset><mesh name="part" file="part.obj" scale="1 1 1"/></asset><worldbody>
<body name="thing" pos="0 0 1"><freejoint/><geom type="mesh" mesh="part" rgba="1 0 0 1"/>
<geom type="capsule" size="0.02 0.05" pos="0 0.1 0" contype="0" conaffinity="0"/>
<body name="lid"><joint type="hinge" axis="0 1 0"/>
<geom type="box" size="0.05 0.05 0.01" pos="0 0 0.11"/></body></body></worldbody></mujoco>"""


POSES = """{"pool": "dining", "support": {"name": "table", "top": 0.7}, "unit": "cm", "objects": [
{"name": "mug", "position": [10, -20.5, 75], "quaternion_xyzw": [0, 0, 0.7, 0.7], "comment": "left"},
{"name": "mug.b", "asset": "mug", "position_cm": {"x": 1, "y": 2, "z": 75}, "rpy_deg": [0, 10, 90]},
{"name": "bowl", "position": [0, 0, 75], "yaw": 1.5, "yaw_deg": 85.943669}]}"""

WEIGHED = URDF.replace(
    "</link>",
    '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
    "</link>",
)

STAGE = """#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 0.01
)
def Xform "thing" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
{
    float physics:mass = 0.3
    point3f physics:centerOfMass = (0, 1, 0)
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:scale"]
    def Mesh "mesh" (prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"])
    {
        uniform token physics:approximation = "none"
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
        int[] faceVertexCounts = [3, 3, 3, 3]
        int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
    }
    def Cylinder "rod" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        double radius = 2
        double height = 5
        uniform token axis = "X"
    }
}
def Cube "floor" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{
    double size = 9
}
"""

MODEL = SDF[SDF.index("<model") : SDF.index("</sdf>")].replace(
    "<box>\n<size>0.1 0.1 0.2</size></box>", "<mesh><uri>part.obj</uri></mesh>"
)
WORLD = f"""<sdf version="1.9"><world name="w"><gravity>0 0 -9.81</gravity><physics type="ode">
<max_step_size>0.002</max_step_size></physics><include><uri>model://ground_plane</uri></include>
<frame name="up"><pose>0 0 0.5 0 0 1</pose></frame><model name="shelf"><static>true</static><link name="l">
<collision name="c"><geometry><plane><normal>0 0.1 1</normal></plane></geometry></collision></link></model>
{MODEL}
</world></sdf>"""


def _scene(folder: Path) -> None:
    poses = np.array([[0.0, 0.0, 0.75, 1.0, 0.0, 0.0, 0.0]])
    with banks.writer(folder, 1):
        pass
    text = scene_xml([trio()[0]], poses, cuboid_table(), StabilityConfig(), ContactConfig())
    (folder / "scenes").mkdir()
    (folder / "scenes" / "000000.xml").write_bytes(text)


LAYOUT = """title: A meal
objects: {mine: mug, yours: bowl}
relations: ["mine left_of yours"]
pool: dining
others: 2
"""
TOML = """[default]
density = 700
["part.obj"]
scale = 0.5
licence = "CC0"
"""
CSV = "file,density,label\npart.obj,700,part\n"
CAMERAS = """{"cameras": [{"name": "front", "width": 64, "height": 48, "K": [[50, 0, 32], [0, 50, 24],
[0, 0, 1]], "T_world_camera": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.9], [0, 0, 0, 1]]}]}"""
BROKEN = """{"pool": "dining", "support": "table", "objects": [{"name": "mug", "position": [0, 0, 0.5],
"quaternion_wxyz": [1, 0, 0, 0]}]}"""
MTL = "newmtl red\nKd 1 0 0\nd 0.9\nmap_Kd -s 1 1 1 picture.png\n"


def _lines(name: str, text: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)

    return make


def _included(folder: Path) -> None:
    _text("inner.sdf", SDF)(folder)
    include = "<include><uri>inner.sdf</uri><name>other</name><pose>0 0 1 0 0 0</pose></include>"
    (folder / "outer.sdf").write_text(
        f'\n<?xml version="1.0"?><sdf><model name="m">{include}</model></sdf>'
    )


def _coloured(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    box = trimesh.creation.box((0.1, 0.1, 0.2)).export(file_type="obj")
    (folder / "thing.obj").write_text(f"mtllib thing.mtl\nusemtl red\n{box}")
    (folder / "thing.mtl").write_text(MTL)
    Image.new("RGB", (4, 4)).save(folder / "picture.png")


def _words_of_a_set(folder: Path) -> None:
    """What a set keeps beside its objects, packed."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "words.json.gz").write_bytes(
        gzip.compress(b'{"thing": {"label": "a thing"}}', mtime=0)
    )


def _look_up(folder: Path) -> object:
    return sets._parse(folder / "words.json.gz", time.monotonic_ns(), 0)


def _judged(folder: Path) -> None:
    model = read_model(folder / "thing.xml")[0]
    read_starts(model, folder / "thing.xml", None, 4)


def _states(folder: Path) -> None:
    _text("thing.xml", MJCF)(folder)
    model = read_model(folder / "thing.xml")[0]
    np.savez(folder / "thing.npz", states=np.tile(model.qpos0, (2, 1)))


READERS = {
    "bank_record": Reader(_bank, "bank.json", _read_bank),
    "bank_record_signed": Reader(_bank, "bank.json", _read_bank, _sign(None)),
    "bank_block": Reader(_bank, "scenes-000000.parquet", _read_bank),
    "bank_block_plain": Reader(
        lambda f: _bank(f, checksums=False), "scenes-000000.parquet", _read_bank
    ),
    "alone_record": Reader(_no_digests, "bank.json", _stand_alone, _sign(None)),
    "alone_block": Reader(_no_digests, "scenes-000000.parquet", _stand_alone),
    "alone_block_sealed": Reader(_bank, "scenes-000000.parquet", _values_alone, mark=b""),
    "alone_part": Reader(_bank, "assets/objects/box/part-00.obj", _values_alone, mark=b""),
    "alone_bank_record": Reader(_bank, "bank.json", _values_alone, _sign(None)),
    "alone_object": Reader(_no_digests, "assets/objects/can/object.json", _stand_alone),
    "alone_support": Reader(_no_digests, "assets/support/support.json", _stand_alone),
    "bank_scene": Reader(
        _scene,
        "scenes/000000.xml",
        lambda f: verify_scene(f / "scenes" / "000000.xml", VerifyConfig(0.05)),
    ),
    "bank_part": Reader(
        _scene,
        "assets/objects/box/part-00.obj",
        lambda f: verify_scene(f / "scenes" / "000000.xml", VerifyConfig(0.05)),
    ),
    "object": Reader(
        lambda f: write_object(f, trio()[1]),
        "object.json",
        lambda f: plain(read_object(f)),
        mark=b"",
    ),
    "object_signed": Reader(
        lambda f: write_object(f, trio()[1]), "object.json", read_object, _sign((",", ":"))
    ),
    "object_cloud": Reader(
        lambda f: write_object(f, trio()[1]), "cloud.npy", lambda f: plain(read_object(f)), mark=b""
    ),
    "pool": Reader(
        lambda f: write_pool(f, Pool("trio", tuple(trio()))),
        "pool.json",
        lambda f: plain(read_pool(f)),
        mark=b'"sha256"',
    ),
    "support": Reader(
        lambda f: write_support(f, cuboid_table()),
        "support.json",
        lambda f: plain(read_support(f)),
        mark=b'"sha256"',
    ),
    "support_old": Reader(
        without_seal(lambda f: write_support(f, cuboid_table()), "support.json"),
        "support.json",
        read_support,
    ),
    "checkpoint_record": Reader(_policy, "record.json", _read_placement, mark=b'"sha256"'),
    "checkpoint_record_old": Reader(
        without_seal(_policy, "record.json"), "record.json", read_checkpoint
    ),
    "checkpoint_weights": Reader(
        _policy, "weights.npz", lambda f: plain(read_policy(f, LIKE)), mark=b""
    ),
    **{name: _own(name) for name in OWN},
    **{
        f"{name}_old": _old(name)
        for name in ("pairs_record", "pairs_block", "views_record", "views_block")
    },
    **{f"{name}_old": _old(name) for name in ("grasps", "store_row", "certainty", "frame_camera")},
    "urdf": Reader(_text("thing.urdf", URDF), "thing.urdf", _read_shapes),
    "urdf_label": Reader(_text("thing.urdf", URDF), "label.json", _read_shapes),
    "urdf_mesh": Reader(_text("thing.urdf", URDF), "part.obj", _read_shapes),
    "sdf": Reader(_sdf, "thing.sdf", _read_shapes),
    "sdf_script": Reader(_sdf, "red.material", _read_shapes),
    "sdf_config": Reader(_sdf, "model.config", _read_shapes),
    "mjcf": Reader(_text("thing.xml", MJCF), "thing.xml", _read_shapes),
    "mjcf_mesh": Reader(_text("thing.xml", MJCF), "part.obj", _read_shapes),
    "mjcf_scene": Reader(
        _text("thing.xml", MJCF), "thing.xml", lambda f: read_mjcf_scene(f / "thing.xml")
    ),
    "layout_json": Reader(
        _text("thing.json", POSES),
        "thing.json",
        lambda f: read_layout_json(f / "thing.json").entries,
    ),
    "judged_urdf": Reader(
        _text("thing.urdf", WEIGHED), "thing.urdf", lambda f: load_model(f / "thing.urdf")
    ),
    "judged_sdf": Reader(
        _text("thing.sdf", WORLD), "thing.sdf", lambda f: load_model(f / "thing.sdf")
    ),
    "judged_sdf_mesh": Reader(
        _text("thing.sdf", WORLD), "part.obj", lambda f: load_model(f / "thing.sdf")
    ),
    **{suffix.strip("."): _mesh(suffix) for suffix in (".obj", ".stl", ".ply", ".glb", ".dae")},
    "sdf_include": Reader(_included, "outer.sdf", _read_shapes),
    "sdf_included": Reader(_included, "inner.sdf", _read_shapes),
    "mtl": Reader(_coloured, "thing.mtl", _read_shapes),
    "texture": Reader(_coloured, "picture.png", _read_shapes),
    "set_words": Reader(_words_of_a_set, "words.json.gz", _look_up),
    "settings_toml": Reader(
        _lines("objects.toml", TOML),
        "objects.toml",
        lambda f: read_settings(f / "objects.toml").tables,
    ),
    "settings_csv": Reader(
        _lines("a.csv", CSV), "a.csv", lambda f: read_settings(f / "a.csv").tables
    ),
    "layout": Reader(_lines("a.yaml", LAYOUT), "a.yaml", lambda f: read_layout(f / "a.yaml")),
    "robot": Reader(
        _lines("a.yaml", (ROBOTS / "panda.yaml").read_text()),
        "a.yaml",
        lambda f: read_robot(f / "a.yaml"),
    ),
    "cameras": Reader(
        _lines("a.json", CAMERAS), "a.json", lambda f: repr(parse_cameras([f / "a.json"]))
    ),
    "broken_layout": Reader(
        _lines("a.json", BROKEN),
        "a.json",
        lambda f: repair._layouts_of_files([f / "a.json"], None, None),
    ),
    "judged": Reader(_text("thing.xml", MJCF), "thing.xml", _judged),
    "judged_states": Reader(_states, "thing.npz", _judged),
    "glb_finish": Reader(_finished_glb, "slab.glb", _read_shapes),
    "mtl_finish": Reader(_finished_obj, "slab.mtl", _read_shapes),
    "normal_map": Reader(_finished_obj, "n.png", _read_shapes),
    "gltf_skinned": Reader(skinned, "thing.gltf", _read_shapes),
    "stl_ascii": _mesh(".stl", "stl_ascii"),
    "ply_ascii": _mesh(".ply", encoding="ascii"),
}

if find_spec("pxr"):
    READERS["judged_usd"] = Reader(
        _text("thing.usda", STAGE), "thing.usda", lambda f: load_model(f / "thing.usda")
    )


class Bench:
    """One reader's folder, into which mutated files are put."""

    def __init__(self, name: str, folder: Path) -> None:
        self.reader = READERS[name]
        self.folder = folder / name
        self.reader.make(self.folder)
        self.file = self.folder / self.reader.file
        self.sound = self.file.read_bytes()
        self.value = self.reader.read(self.folder)

    def mutant(self, seed: int) -> bytes:
        """The file after some accidents."""
        data = mutated(self.sound, random.Random(seed))
        return data if self.reader.signed is None else self.reader.signed(data)

    def try_out(self, data: bytes) -> bool:
        """Whether the mutant could be read; any error but ours, and any other value, comes through."""
        self.file.write_bytes(data)
        try:
            value = self.reader.read(self.folder)
        except ClutterGenError:
            return False
        finally:
            self.file.write_bytes(self.sound)
        mark = self.reader.mark
        assert mark is None or mark not in data or value == self.value, "another value, in silence"
        return True

    def flipped(self, seed: int) -> bytes:
        """The file with one bit changed."""
        return _flip(self.sound, random.Random(seed))


def _hunt(name: str, seconds: float, first: int) -> None:
    """Looks for crashes of one reader; prints where they come from and keeps one of each kind."""
    seen: set[str] = set()
    folder = Path(tempfile.mkdtemp())
    bench = Bench(name, folder)
    tries = 0
    read = 0
    end = time.monotonic() + seconds
    suspect = CORPUS / name / "suspect"
    suspect.parent.mkdir(parents=True, exist_ok=True)
    while time.monotonic() < end:
        data = bench.mutant(first + tries)
        # If the process dies or hangs over it, this is what is found.
        suspect.write_bytes(data)
        tries += 1
        started = time.monotonic()
        faulthandler.dump_traceback_later(60, exit=True)
        try:
            read += bench.try_out(data)
        except Exception as error:
            frames = [
                f
                for f in traceback.extract_tb(error.__traceback__)
                if "cluttergen_jax" in f.filename
            ]
            where = (
                f"{type(error).__name__} {frames[-1].filename.split('/')[-1]}:{frames[-1].lineno}"
            )
            if where not in seen:
                seen.add(where)
                print(f"{name}: {where}: {error!s:.150}", flush=True)
                digest = hashlib.sha256(data).hexdigest()[:10]
                (CORPUS / name / digest).write_bytes(data)
        finally:
            faulthandler.cancel_dump_traceback_later()
        if time.monotonic() - started > 5:
            print(f"{name}: slow: {time.monotonic() - started:.1f} s", flush=True)
            shutil.copy(suspect, suspect.with_name(f"slow-{hashlib.sha256(data).hexdigest()[:10]}"))
    suspect.unlink()
    if not any(suspect.parent.iterdir()):
        suspect.parent.rmdir()
    shutil.rmtree(folder)
    print(f"{name}: {tries} mutants, {read} could be read, {len(seen)} kinds of crash", flush=True)


if __name__ == "__main__":
    for reader in sys.argv[3:] or READERS:
        _hunt(reader, float(sys.argv[1]), int(sys.argv[2]))
