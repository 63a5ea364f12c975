"""A format of a user's own, and scenes that no bank holds."""

import hashlib
import json
from dataclasses import replace

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.export import FORMATS, export_scenes
from cluttergen_jax.scene.export.formats import find_format
from tests.helpers.exports import dining_scene, fourteen_scenes

FILE = """
import json
from dataclasses import dataclass

import cluttergen_jax as cg


@dataclass(frozen=True)
class Writer:
    indent: "int"

    def __call__(self, path, scene):
        path.write_text(json.dumps(dict(zip(scene.names, scene.poses.tolist())), indent=self.indent))


def write_asset(folder, asset, contact):
    (folder / "mass.txt").write_text(str(asset.mass))


POSES = cg.Format("poses", "any reader of JSON.", "json", write_asset, None, Writer(1))
NOTHING = 3
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    (tmp_path / "my_format.py").write_text(FILE)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "my_format.py"


@pytest.mark.parametrize("asked", ["my_format.py:POSES", "my_format:POSES"])
def test_a_bank_is_exported_in_a_format_of_a_users_file(asked, file, tmp_path, capsys):
    bank = fourteen_scenes(tmp_path / "bank")
    assert main(["export", str(bank), "--format", asked, "--scenes", "0-1", "--out", "out"]) == 0
    assert "open with any reader of JSON." in capsys.readouterr().out
    record = json.loads((tmp_path / "out" / "MANIFEST.json").read_text())
    assert record["export_format"] == "poses"
    assert record["own_format"]["defined_in"].endswith("my_format:Writer")
    assert record["own_format"]["file"] == "my_format.py"
    assert record["own_format"]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    for stored in record["scenes"]:
        poses = json.loads((tmp_path / "out" / stored["file"]).read_text())
        assert list(poses) == [each["name"] for each in stored["objects"]]
    assert all(
        (tmp_path / "out" / each["folder"] / "mass.txt").exists() for each in record["assets"]
    )


def test_formats_of_the_package_are_told_as_before(tmp_path):
    folder = cg.export(dining_scene(), tmp_path / "out")
    assert "own_format" not in json.loads((folder / "MANIFEST.json").read_text())


def test_a_registered_format_goes_by_its_name(file, tmp_path, monkeypatch):
    monkeypatch.setattr("cluttergen_jax.scene.export.formats.FORMATS", dict(FORMATS))
    own = find_format("my_format.py:POSES")
    with pytest.raises(ConfigError, match=r"format 'poses'.*FILE.py:NAME"):
        cg.export(dining_scene(), tmp_path / "out", "poses")
    assert cg.register_format(own) is own
    assert cg.register_format(replace(own, notes="another")).notes == "another"
    folder = cg.export(dining_scene(), tmp_path / "out", "poses")
    assert "another" in (folder / "README.txt").read_text()


@pytest.mark.slow
def test_a_scene_that_was_just_sampled_is_exported(tmp_path):
    sampler = cg.make_sampler(pool="dining", num_objects=2, method="drop")
    scene = sampler.scene(sampler(jax.random.key(0)))
    folder = cg.export(scene, tmp_path / "one")
    (stored,) = json.loads((folder / "MANIFEST.json").read_text())["scenes"]
    placed = [each["position"] for each in stored["objects"]]
    np.testing.assert_allclose(placed, scene.poses[:, :3], atol=1e-6)
    with pytest.raises(ConfigError, match=r"SceneBatch.*sampler\.scene"):
        cg.export(sampler(jax.random.key(0)), tmp_path / "batch")


def test_several_scenes_are_exported_at_once(tmp_path):
    scene = dining_scene()
    other = replace(scene, origin=replace(scene.origin, index=4))
    folder = cg.export((each for each in (scene, other)), tmp_path / "out")
    assert [each.stem for each in sorted((folder / "scenes").glob("*.xml"))] == ["000000", "000004"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("nowhere.py:POSES", "'nowhere.py' cannot be imported.*FILE.py:NAME"),
        ("no_such_module:POSES", "No module named 'no_such_module'"),
        ("my_format.py:POSE", "'POSE' of my_format.py is missing.*POSES"),
        ("my_format.py:NOTHING", "'NOTHING' of my_format.py is no Format.*POSES"),
        ("broken.py:POSES", "broken.py' cannot be imported: division"),
        ("mjfc", "format 'mjfc'.*mjcf"),
        (3, "the format 3.*cluttergen_jax.Format"),
        (
            "mujoko",
            r"format 'mujoko'\. Did you mean 'mujoco'\?.*mjlab, playground, lerobot.*'mjcf'\.$",
        ),
        ("newton", r"format 'newton'\. Allowed: mjcf, .*Try: format='mjcf'\.$"),
        ("dm-control", "format='mjcf'"),
        ("drake", "format='sdf'"),
        ("pybullet", "format='urdf'"),
        ("isaac", "format='usd'"),
        ("gymnasium", "format='lerobot'"),
        ("qqqqq", r"Try: docs/guide/export\.md"),
    ],
)
def test_a_wrong_format_is_told_apart(asked, said, file, tmp_path):
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(ConfigError, match=said):
        cg.export(dining_scene(), tmp_path / "out", asked)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"name": "mjcf"}, "called 'mjcf', which this package has.*my-mjcf"),
        ({"name": "lerobot"}, "called 'lerobot', which this package has"),
        ({"name": "a/b"}, "name 'a/b'"),
        ({"ending": ""}, "ending ''"),
        ({"write_scene": None}, "write_scene is None"),
        ({"write_object": 3}, "write_object is 3"),
        ({"scripts": ("load_pybullet.py",)}, "no script"),
    ],
)
def test_a_wrong_field_of_a_format_is_named(changed, said, file):
    own = find_format("my_format.py:POSES")
    with pytest.raises(ConfigError, match=said):
        cg.register_format(replace(own, **changed))


def test_what_is_no_scene_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"`source` of int.*sampler\.scene"):
        cg.export(3, tmp_path / "out")
    with pytest.raises(ConfigError, match="`source` of str"):
        cg.export(["bank"], tmp_path / "out")
    with pytest.raises(ConfigError, match="`scenes` beside scenes"):
        cg.export(dining_scene(), tmp_path / "out", scenes="0-3")
    with pytest.raises(ConfigError, match="takes a whole bank"):
        cg.export(dining_scene(), tmp_path / "out", "lerobot")
    with pytest.raises(ConfigError, match="'mjlab' of scenes, which takes a whole bank"):
        export_scenes([dining_scene()], tmp_path / "out", "mjlab")
    with pytest.raises(ConfigError, match="`robot` with the format 'mjcf', which has none"):
        cg.export(dining_scene(), tmp_path / "out", "mjcf", robot="panda")
