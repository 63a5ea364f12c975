"""The reader that lies beside every bank: it stands alone, and reads and writes what the package does."""

import ast
import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import jax
import mujoco
import numpy as np
import pyarrow as pa
import pytest

import cluttergen_jax as cg
from cluttergen_jax import bank_reader
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Texture
from cluttergen_jax.cli.main import main
from cluttergen_jax.config import ROBUST_TILT, ContactConfig, StabilityConfig, VerifyConfig
from cluttergen_jax.judging.verify import verify_files
from cluttergen_jax.scene.bank import BankWriter, read_bank
from cluttergen_jax.scene.bank.hub import pull, push
from cluttergen_jax.scene.bank.index import changes_of
from cluttergen_jax.scene.bank.record import index_bytes
from cluttergen_jax.scene.bank.table import SCHEMA
from cluttergen_jax.scene.export.mjcf import scene_xml
from cluttergen_jax.schema import digest_of
from tests.helpers import banks, shiny, textured
from tests.helpers.environments import python_with
from tests.helpers.exports import dining_scene, fourteen_scenes, row_of, spread

SOURCE = Path(bank_reader.__file__)
PROGRAM = Path(__file__).parents[1] / "peers" / "read_bank.py"
GOLDEN = Path(__file__).parents[1] / "golden" / "bank"
SHORT = VerifyConfig(0.1)
ROBUST = StabilityConfig(both_detectors=True, robust_tilt=ROBUST_TILT)


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    return fourteen_scenes(tmp_path_factory.mktemp("banks") / "bank")


def sticker():
    """A textured slab that is slippery and has a flat surface besides."""
    corners = np.array([[0, 0, 0.02], [0.02, 0, 0.02], [0.02, 0.02, 0.02], [0, 0.02, 0.02]])
    flat = Piece(Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])), (0.9, 0.1, 0.1, 1.0))
    slab = textured.asset("slab")
    return replace(slab, friction=0.2, pieces=(*slab.pieces, flat))


@pytest.fixture(scope="module")
def rich(tmp_path_factory):
    """A bank of one scene with all that a scene can have, and the scene."""
    plain = dining_scene()
    # In place of the fork.
    objects = (plain.objects[0], sticker(), *plain.objects[2:])
    names = ("mug", "slab", *plain.names[2:])
    scene = replace(spread(objects, plain.support, names), stability=ROBUST)
    recipe = {"names": list(names), "stability": asdict(ROBUST), "contact": asdict(ContactConfig())}
    path = tmp_path_factory.mktemp("banks") / "rich"
    with BankWriter(path, recipe, 3, scene.assets, scene.support) as writer:
        writer.write_block(0, pa.Table.from_pylist([row_of(scene, 0, True)], schema=SCHEMA))
    return path, scene


def elements(text, unlike=()):
    """What an MJCF says, element by element, in any order, but for these attributes."""
    return sorted(
        (each.tag, sorted((k, v) for k, v in each.attrib.items() if k not in unlike))
        for each in ET.fromstring(text).iter()
    )


@pytest.mark.parametrize("bank", ["few", GOLDEN, "whole"])
def test_it_reads_what_the_package_reads(request, bank):
    path = bank if isinstance(bank, Path) else request.getfixturevalue(bank)
    ours = read_bank(path)
    theirs = bank_reader.Bank(path)
    rows = list(ours.scenes())
    assert (len(theirs), theirs.num_asked) == (len(rows), ours.num_scenes)
    assert theirs.recipe == ours.recipe
    numbers = ours.table["object_index"].to_pylist()
    for row, scene, slots in zip(rows, theirs, numbers, strict=True):
        assert (scene.index, scene.is_success, scene.verdict) == (
            row.index,
            row.is_success,
            row.verdict,
        )
        assert scene.names == row.objects
        assert tuple(theirs.names[each] for each in scene.object_index) == scene.names
        assert len(scene.names) + len(scene.unplaced) == len(slots)
        np.testing.assert_array_equal(scene.poses, row.poses)
        again = theirs.scene(row.index)
        assert again.names == scene.names
        np.testing.assert_array_equal(again.qpos.reshape(-1, 7), scene.poses)
    for name in ours.assets["objects"]:
        asset = theirs.asset(name)
        own = ours.object(name)
        assert (asset.label, asset.record["mass"]) == (own.label, own.mass)
        assert (len(asset.parts), len(asset.surfaces)) == (len(own.parts), len(own.pieces))
        assert all(each.is_file() for each in asset.parts)


def test_it_draws_what_load_bank_draws(few):
    bank = bank_reader.Bank(few)
    loaded = cg.load_bank(few)
    arrays = bank.arrays
    np.testing.assert_array_equal(arrays.index, loaded.index)
    np.testing.assert_array_equal(arrays.is_placed, loaded.is_placed)
    np.testing.assert_array_equal(arrays.poses, loaded.poses)
    named = np.array([*bank.names, ""])[arrays.object_index]
    assert (named == np.array([*loaded.names, ""])[np.asarray(loaded.object_index)]).all()
    keys = jax.random.split(jax.random.key(5), 8)
    # What is read first within a compiled function is no part of it.
    drawn = jax.jit(jax.vmap(bank.reset_jax))(keys)
    np.testing.assert_array_equal(
        drawn.index, jax.jit(jax.vmap(lambda key: loaded.reset(key).index))(keys)
    )
    np.testing.assert_array_equal(bank.reset_jax(keys[0]).poses, drawn.poses[0])
    assert not bank.scene(4).is_success
    assert 4 not in arrays.index
    draw = np.random.default_rng(1)
    for _ in range(8):
        scene = bank.reset(draw)
        np.testing.assert_array_equal(scene.poses, bank.scene(scene.index).poses)
        assert scene.is_success


def test_all_objects_stand_in_one_model(few):
    bank = bank_reader.Bank(few)
    model = bank.model()
    data = mujoco.MjData(model)
    qpos, held = jax.jit(bank.state)(bank.reset_jax(jax.random.key(0)))
    data.qpos[:] = qpos
    data.xfrc_applied[2:] = held
    mujoco.mj_step(model, data, 120)
    assert np.abs(data.qpos - np.asarray(qpos)).max() < 1e-3
    # Another object in the air: the box is not in the scene, and does not fall.
    scene = type(bank.arrays)(*(each[0] for each in bank.arrays))
    scene = scene._replace(is_placed=np.array([False, True, True]))
    qpos, held = bank.state(scene)
    np.testing.assert_allclose(qpos.reshape(-1, 7)[1:], scene.poses[1:])
    mujoco.mj_resetData(model, data)
    data.qpos[:] = qpos
    data.xfrc_applied[2:] = held
    mujoco.mj_step(model, data, 120)
    assert qpos[0] > 10
    assert np.abs(data.qpos[:7] - qpos[:7]).max() < 1e-3
    assert model.body(2).name == bank.names[0]


def test_its_models_are_those_of_the_scene_files(rich):
    path, scene = rich
    wanted = scene_xml(
        scene.objects,
        scene.poses.astype(np.float32),
        scene.support,
        ROBUST,
        scene.contact,
        names=scene.names,
    )
    bank = bank_reader.Bank(path)
    given = bank.xml(0, assets="../assets")
    # Every surface says that it weighs nothing, where the package's files say so of flat ones.
    assert elements(given, ["inertia"]) == elements(wanted, ["inertia"])
    for text in (
        b'margin="5e-05"',
        b'nativeccd="disable"',
        b'priority="98000"',
        b'material="texture-',
        b'inertia="shell"',
    ):
        assert text in wanted
        assert text.decode() in given
    model = bank.model(0)
    assert model.opt.timestep == 1 / 480
    assert [model.body(int(each)).name for each in model.jnt_bodyid] == list(scene.names)
    np.testing.assert_allclose(model.key("scene").qpos.reshape(-1, 7), scene.poses, atol=1e-6)


def test_objects_and_the_support_come_alone_too(rich):
    path, scene = rich
    reader = bank_reader.Bank(path)
    whole = reader.model(0)
    for name, asset in scene.assets.items():
        alone = mujoco.MjModel.from_xml_string(reader.object_xml(name, "object"))
        assert (alone.nbody, alone.njnt, alone.nlight, alone.nkey) == (2, 1, 0, 0)
        assert alone.joint("object").type == mujoco.mjtJoint.mjJNT_FREE
        assert alone.body("object").mass == pytest.approx(asset.mass, rel=1e-6)
        same = whole.geom_bodyid == whole.body(name).id
        for field in ("geom_friction", "geom_solref", "geom_priority", "geom_group", "geom_rgba"):
            np.testing.assert_array_equal(getattr(alone, field), getattr(whole, field)[same])
    support = mujoco.MjModel.from_xml_string(reader.support_xml())
    assert (support.nbody, support.njnt) == (2, 0)
    assert support.ngeom == whole.body("support").geomnum
    with pytest.raises(bank_reader.BankError, match="no files of an object"):
        reader.object_xml("nothing")


def test_an_old_bank_gives_the_models_of_its_scene_files():
    bank = bank_reader.Bank(GOLDEN)
    for index in bank.arrays.index.tolist():
        saved = mujoco.MjModel.from_xml_path(str(GOLDEN / f"scenes/{index:06d}.xml"))
        model = bank.model(index)
        for name in (
            "body_mass",
            "body_inertia",
            "geom_friction",
            "geom_solref",
            "mesh_vert",
            "key_qpos",
            "qpos0",
        ):
            np.testing.assert_array_equal(getattr(model, name), getattr(saved, name), name)
        assert (model.opt.timestep, model.opt.disableflags) == (
            saved.opt.timestep,
            saved.opt.disableflags,
        )


def test_older_versions_get_the_words_that_they_know(rich):
    bank = bank_reader.Bank(rich[0])
    known = {
        version: bank.xml(0, version=version)
        for version in ("2.3.7", "3.2.2", "3.2.3", "3.3.0", "3.17.0")
    }
    assert ['nativeccd="' in text for text in known.values()] == [False, False, True, True, True]
    assert ['inertia="shell"' in text for text in known.values()] == [
        False,
        False,
        False,
        True,
        True,
    ]
    # Otherwise they say the same.
    unlike = ["nativeccd", "inertia"]
    assert all(elements(text, unlike) == elements(bank.xml(0), unlike) for text in known.values())


def test_it_knows_finishes(tmp_path):
    """Roughness, metalness and layers are said as in scene files, to MuJoCo that reads them."""
    orm = Texture.of(shiny.gloss(0.5, 0.8))
    dull = shiny.asset("dull", has_image=False, normal=None, roughness=0.9, metallic=0.0)
    scene = textured.scene(shiny.asset("brass", orm=orm), dull, textured.asset("plain"))
    recipe = {"names": list(scene.names), "stability": asdict(scene.stability)}
    recipe |= {"contact": asdict(scene.contact)}
    with BankWriter(tmp_path / "bank", recipe, 1, scene.assets, scene.support) as writer:
        writer.write_block(0, pa.Table.from_pylist([row_of(scene, 0, True)], schema=SCHEMA))
    assert len(list((tmp_path / "bank" / "assets" / "textures").iterdir())) == 3
    wanted = scene_xml(
        scene.objects,
        scene.poses.astype(np.float32),
        scene.support,
        scene.stability,
        scene.contact,
        names=scene.names,
    )
    bank = bank_reader.Bank(tmp_path / "bank")
    given = bank.xml(0, assets="../assets")
    assert elements(given, ["inertia"]) == elements(wanted, ["inertia"])
    assert "<layer" in given
    assert bank.asset("brass").finishes[0]["orm"].read_bytes() == orm.data
    assert bank.asset("plain").finishes == (None,)
    assert sorted(bank.model(0).mat_roughness) == pytest.approx([-1, 0.1, 0.9])
    for version, words in {"3.1.6": 0, "3.2.3": 1, "3.2.7": 2}.items():
        text = bank.xml(0, version=version)
        assert [word in text for word in ("roughness=", "<layer")] == [words > 0, words > 1]


ALONE = """
import sys

class Refuse:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ("cluttergen_jax", "jax", "mujoco", "lxml", "msgspec", "scipy"):
            raise ImportError(name)

sys.meta_path.insert(0, Refuse())
from bank_reader import Bank, BankError, main
bank = Bank(".")
print(bank, float(sum(scene.poses.sum() for scene in bank)), bank.reset(0).index)
main([".", "--xml", "0"])
try:
    bank.model(0)
except BankError as error:
    print(error)
"""


def test_it_stands_alone_beside_its_bank(few):
    words = [sys.executable, "-c", ALONE]
    done = subprocess.run(words, cwd=few, env={}, capture_output=True, text=True, check=True)
    bank = bank_reader.Bank(few)
    total = float(sum(scene.poses.sum() for scene in bank))
    first, *text, last = done.stdout.splitlines()
    assert first == f"Bank('.', 14 of 14 scenes) {total} {bank.reset(0).index}"
    assert last == "a model without MuJoCo. Allowed: 2.3.7 or newer. Try: pip install mujoco."
    assert elements("\n".join(text)) == elements(bank.xml(0, version="3.17"))
    # The syntax of Python 3.8, which LIBERO runs on.
    ast.parse(SOURCE.read_text(), feature_version=(3, 8))


def test_shards_gaps_and_shelves_are_read(tmp_path):
    names = ["spare", *banks.NAMES, "other"]
    with banks.writer(
        tmp_path / "bank", 5 * 256, {**banks.RECIPE, "names": names, "shelf": 3}, shard_blocks=2
    ) as bank:
        for block in (0, 1, 2, 4):
            rows = banks.rows(block, 256 if block < 4 else 7).to_pylist()
            shelved = [
                row | {"object_index": [each + 1 for each in row["object_index"]]} for row in rows
            ]
            bank.write_block(block, pa.Table.from_pylist(shelved, schema=SCHEMA))
    files = sorted(each.name for each in (tmp_path / "bank").glob("*.parquet"))
    assert files == [
        "scenes-000000-000001.parquet",
        "scenes-000002.parquet",
        "scenes-000004.parquet",
    ]
    ours = read_bank(tmp_path / "bank")
    bank = bank_reader.Bank(tmp_path / "bank")
    assert (len(bank), bank.num_asked) == (3 * 256 + 7, 5 * 256)
    assert "775 of 1280 are there" in bank.summary()
    for index in (0, 300, 600, 1030):
        row = ours.rows([index])[index]
        assert bank.scene(index).names == row.objects
        np.testing.assert_array_equal(bank.scene(index).poses, row.poses)
    np.testing.assert_array_equal(
        np.concatenate([scene.object_index for scene in bank.successes()]),
        [
            each
            for row in ours.table.to_pylist()
            if row["is_success"]
            for each in row["object_index"]
        ],
    )
    with pytest.raises(
        bank_reader.BankError, match=r"no scene 800. Allowed: 0 to 1030, 775 scenes"
    ):
        bank.scene(800)


def test_a_block_that_is_written_again_holds_beside_its_shard(tmp_path):
    path = tmp_path / "bank"
    with banks.writer(path, 2 * 256, shard_blocks=2) as bank:
        for block in (0, 1):
            bank.write_block(block, banks.rows(block))
    rows = banks.rows(1).to_pylist()
    ours = read_bank(path)
    rows[0]["poses"][0][0] = 0.111
    record = {
        name: value for name, value in ours.record.items() if name not in ("num_scenes", "files")
    }
    banks.write_rows(path, 1, pa.Table.from_pylist(rows, schema=SCHEMA), record)
    assert len(list(path.glob("*.parquet"))) == 2
    assert bank_reader.Bank(path).scene(256).poses[0][0] == np.float32(0.111)
    assert read_bank(path).rows([256])[256].poses[0][0] == np.float32(0.111)


def no_bank(path):
    (path / "bank.json").unlink()


def newer(path):
    record = json.loads((path / "bank.json").read_bytes())
    (path / "bank.json").write_bytes(index_bytes({**record, "format": 7}))


def forged(path):
    text = (path / "bank.json").read_text()
    (path / "bank.json").write_text(text.replace('"num_scenes": 3', '"num_scenes": 4'))


def damaged(path):
    data = bytearray((path / "scenes-000000.parquet").read_bytes())
    data[4:2000] = bytes(each ^ 255 for each in data[4:2000])
    (path / "scenes-000000.parquet").write_bytes(data)


def cut(path):
    (path / "scenes-000000.parquet").write_bytes(b"PAR1")


def exchanged(path):
    (path / "scenes-000000.parquet").rename(path / "scenes-000003.parquet")


def heavier(path):
    file = path / "assets/objects/box/object.json"
    file.write_text(file.read_text().replace('"mass":0.2', '"mass":20'))


def without_part(path):
    (path / "assets/objects/box/part-00.obj").unlink()


def read_all(path):
    bank = bank_reader.Bank(path)
    return list(bank), bank.labels


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (no_bank, "is not a bank: it has no bank.json. Allowed: a folder of"),
        (
            newer,
            "made by a newer version .format 7; this file reads 1.. Try: the bank_reader.py of a newer",
        ),
        (forged, "bank.json is damaged .it does not match its own digest"),
        (damaged, "scenes-000000.parquet is damaged .*Try: the same `cluttergen generate` again"),
        (cut, "scenes-000000.parquet is damaged"),
        (
            exchanged,
            "scenes-000003.parquet is damaged .its scenes are not those that its name says",
        ),
        (heavier, "object.json is damaged .it is not what was written"),
        (without_part, "part-00.obj is damaged .*No such file"),
    ],
)
def test_what_is_damaged_is_named(bank, harm, says):
    harm(bank)
    with pytest.raises(bank_reader.BankError, match=says):
        read_all(bank)


def test_what_cannot_be_is_refused(few, tmp_path):
    bank = bank_reader.Bank(few)
    for call, says in {
        lambda: bank.scene(99): "no scene 99. Allowed: 0 to 13, 14 scenes",
        lambda: bank.xml(4): r"scene 4 of .* failed \(crept\)",
        lambda: bank.xml(0, version="new"): "version 'new' of MuJoCo",
        lambda: bank.asset("../box"): "no files of an object '../box'. Allowed: box, prism, tall",
        lambda: bank_reader.Bank(few / "bank.json"): "is not a bank",
    }.items():
        with pytest.raises(bank_reader.BankError, match=says):
            call()
    with banks.writer(tmp_path / "none", 4):
        pass
    empty = bank_reader.Bank(tmp_path / "none")
    assert (len(empty), list(empty)) == (0, [])
    with pytest.raises(bank_reader.BankError, match="none of its 0 scenes succeeded"):
        empty.reset(0)


def test_the_command_prints_a_bank_and_a_scene(few, tmp_path, capsys):
    assert bank_reader.main([str(few)]) == 0
    assert "scenes     14 of 14 are there, 12 succeed\n" in capsys.readouterr().out
    assert bank_reader.main([str(few), "--xml", "0"]) == 0
    assert capsys.readouterr().out == bank_reader.Bank(few).xml(0)
    assert bank_reader.main([str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {tmp_path} is not a bank")


def test_it_travels_with_its_bank(bank, tmp_path):
    copy = bank / "bank_reader.py"
    assert copy.read_bytes() == SOURCE.read_bytes()
    assert verify_files(bank, SHORT).is_sound
    (tmp_path / "hub").mkdir()
    push(bank, "me/few", str(tmp_path / "hub"), False)
    # A stranger's program is not fetched, even if their bank.json vouches for it.
    theirs = tmp_path / "hub/me/few"
    evil = b"raise SystemExit('evil')"
    (theirs / "bank_reader.py").write_bytes(evil)
    record = read_bank(theirs).record
    record["files"]["bank_reader.py"] = digest_of(evil)
    (theirs / "bank.json").write_bytes(index_bytes(record))
    pulled = pull("me/few", tmp_path / "here", str(tmp_path / "hub"), None, False)
    assert (pulled / "bank_reader.py").read_bytes() == SOURCE.read_bytes()
    assert changes_of(read_bank(pulled)) == []
    # What was changed is named, and no scene is made of it; it is written again with the bank.
    copy.write_bytes(evil)
    report = verify_files(bank, SHORT)
    assert [each.name for each in report.changes] == ["bank_reader.py"]
    assert report.stands.all()
    banks.with_files(bank)
    assert copy.read_bytes() == SOURCE.read_bytes()


ENVIRONMENTS = [
    ("mujoco==2.3.7", "numpy<2", "pyarrow<21"),
    ("mujoco==3.5.0", "jax==0.6.2", "pyarrow"),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A bank as people make it, without files of scenes."""
    path = tmp_path_factory.mktemp("banks") / "made"
    words = [
        "generate",
        "--pool",
        "dining",
        "--num-objects",
        "8",
        "-n",
        "8",
        "--no-render",
        "--max-files",
        "0",
    ]
    assert main([*words, "--out", str(path)]) == 0
    return path


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("packages", ENVIRONMENTS, ids=" ".join)
def test_hosts_read_a_bank_with_their_own_versions(packages, rich, made, tmp_path):
    python = python_with(tmp_path / "environment", *packages)
    for bank in (rich[0], made):
        done = subprocess.run([python, PROGRAM, bank], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert f"in MuJoCo {packages[0].partition('==')[2]}" in done.stdout
        assert ("resets in JAX" in done.stdout) == ("jax" in packages[1])
