"""Settings per object: what the command line and `objects.toml` say, where it ends up, slips of the pen."""

import re

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.importing import run
from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, read_shape
from cluttergen_jax.importing.readers.source import AXES, turn_of
from tests.helpers.imports import made_here

SIZE = (0.03, 0.05, 0.07)


@pytest.fixture(autouse=True)
def here(home, monkeypatch):
    # Jobs run in this process: spawning has its own tests, and costs seconds.
    monkeypatch.setattr(run, "_outcomes", made_here)


@pytest.fixture
def folder(tmp_path):
    """Boxes of 3, 5 and 7 cm along x, y, z as their files have it."""
    folder = tmp_path / "things"
    (folder / "cups").mkdir(parents=True)
    for name in ("crate.obj", "slab.glb", "cups/small.stl", "cups/large.stl"):
        trimesh.creation.box(SIZE).export(folder / name)
    return folder


def planned(folder, text="", options=None, settings=None):
    (folder / "objects.toml").write_text(text)
    return {
        each.source.name: each
        for each in plan_all([folder], options or ReadOptions(), settings).objects
    }


def size_of(plan):
    shape = read_shape(plan.source, plan.options)
    return (
        np.ptp(join_meshes([piece.mesh for piece in shape.pieces]).bounds, axis=0).round(6).tolist()
    )


def test_the_axis_and_who_says_so(folder, tmp_path):
    trimesh.creation.box(SIZE).export(folder / "cups" / "declared.dae")
    declared = (folder / "cups" / "declared.dae").read_text()
    (folder / "cups" / "side.dae").write_text(declared.replace("Y_UP", "X_UP"))
    plans = planned(folder, '["cups/large.stl"]\nup = "y"\n')
    told = {name: (plan.up.axis, plan.up.reason) for name, plan in plans.items()}
    assert told == {
        "crate": ("z", "by default: OBJ does not say"),
        "slab": ("y", "GLTF's standard"),
        "small": ("z", "by default: STL does not say"),
        "large": ("y", "as objects.toml says"),
        "declared": ("y", "the file's declaration"),
        "side": ("x", "the file's declaration"),
    }
    assert size_of(plans["slab"]) == [0.03, 0.07, 0.05]
    # What is declared to lie on its x axis was once read as if z were up.
    assert size_of(plans["side"]) == [0.05, 0.07, 0.03]
    by_flag = planned(folder, options=ReadOptions(up="z"))["slab"]
    assert (by_flag.up.axis, by_flag.up.reason) == ("z", "as `up` says")
    assert size_of(by_flag) == [0.03, 0.05, 0.07]


def test_settings_of_a_folder_inside_go_before_those_around_it(folder):
    (folder / "cups/objects.toml").write_text(
        '[default]\nscale = 2.0\n["small.stl"]\nname = "beaker"\n'
    )
    plans = planned(folder, "[default]\nscale = 0.5\nfriction = 0.3\n")
    assert {name: plan.options.scale for name, plan in plans.items()} == {
        "crate": 0.5,
        "slab": 0.5,
        "beaker": 2.0,
        "large": 2.0,
    }
    assert {plan.options.friction for plan in plans.values()} == {0.3}
    (folder / "cups/objects.toml").write_text('["smal.stl"]\nscale = 2.0\n')
    with pytest.raises(ConfigError, match=r"cups.objects\.toml.*smal\.stl.*fits no object"):
        planned(folder)


def test_up_becomes_z_and_front_becomes_x():
    axes = {name: np.eye(3)["xyz".index(name[-1])] * (-1 if name[0] == "-" else 1) for name in AXES}
    for up in AXES:
        np.testing.assert_array_equal(turn_of(up) @ axes[up], [0, 0, 1])
        for front in AXES:
            if up[-1] == front[-1]:
                with pytest.raises(ConfigError, match="right angle"):
                    ReadOptions(up=up, front=front)
                continue
            turn = turn_of(up, front)
            np.testing.assert_array_equal(turn @ axes[up], [0, 0, 1])
            np.testing.assert_array_equal(turn @ axes[front], [1, 0, 0])
            assert np.linalg.det(turn) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('["crat.obj"]\nmass = 1\n', r"'crat.obj'\] fits no object. Did you mean 'crate.obj'\?"),
        ('["crate.obj"]\nfricton = 1\n', r"'fricton'. Did you mean 'friction'\?"),
        ("[crate.obj]\nmass = 1\n", "a pattern in quotes"),
        ('["fox.fbx"]\nmass = 1\n', "it is skipped: FBX"),
        ('["crate.obj"]\nmass = -1\n', "'crate.obj'.*mass = -1.*above zero"),
        ('["crate.obj"]\nmass = "heavy"\n', "mass = 'heavy'"),
        ('["crate.obj"]\nup = "w"\n', "up = 'w'.*-z"),
        ('["crate.obj"]\nup = "y"\nfront = "-y"\n', "right angle"),
        ('["crate.obj"]\nlicence = 3\n', "licence = 3"),
        ('["crate.obj"]\nname = "My Crate"\n', "a-z, 0-9"),
        ('["crate.obj"]\nname = "support"\n', "any other name"),
        ('[default]\nname = "crate"\n', "one object's name"),
        ('["cups/*"]\nname = "cup"\n', "'cup' for 2 objects"),
        ("mass = 1\n", "outside a table"),
        ("[default\n", "not TOML"),
    ],
)
def test_slips_of_the_pen(folder, text, message):
    (folder / "fox.fbx").write_text("x")
    with pytest.raises(ConfigError, match=message) as error:
        planned(folder, text)
    assert "objects.toml" in str(error.value) or "settings" in str(error.value)


def test_a_table_of_a_whole_library(folder, tmp_path):
    table = tmp_path / "labels.csv"
    table.write_text(
        "file, label ,mass,up\ncups/*.stl,a cup,0.25,\nlarge.stl,a large cup,,y\ngone.obj,gone,1,x\n"
    )
    plans = planned(folder, settings=table)
    told = {
        name: (plan.source.label, plan.options.mass, plan.up.axis) for name, plan in plans.items()
    }
    assert told["small"] == ("a cup", 0.25, "z")
    assert told["large"] == ("a large cup", 0.25, "y")
    assert told["crate"][:2] == ("crate", None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,label\nmug,cup\n", "columns name, label. Allowed: file, and some of scale"),
        ("file\nmug.obj\n", "columns file"),
        ("file,label\nslab.glb\n", "line 2: 'slab.glb'"),
        ("file,label\nslab.glb,a,b\n", "line 2"),
        ("file,label\nslab.glb,a\nslab.glb,b\n", "line 3: 'slab.glb'"),
        ("file,label\n,a\n", "no file"),
        ("file,labl\nslab.glb,a\n", "key 'labl'.*Did you mean 'label'"),
        ("file,mass\nslab.glb,heavy\n", "mass = 'heavy'"),
        ('file,label\nslab.glb,"a\n', "are not a table of CSV: unexpected end of data"),
        ("file,density\nslab.glb,true\n", "density = True. Allowed: a finite number above zero"),
        ("file,label\nother.glb,a\n", "'other.glb'] fits no object"),
    ],
)
def test_slips_of_a_table(folder, tmp_path, text, message):
    table = tmp_path / "labels.csv"
    table.write_text(text)
    with pytest.raises(ConfigError, match=message):
        planned(folder, settings=table)


def test_the_unit_of_one_file_among_others_is_stated_as_its_advice_says(folder):
    trimesh.creation.box((100, 80, 60)).export(folder / "rack.stl")
    with pytest.raises(AssetError, match="'rack' is 100 m across") as found:
        read_shape(planned(folder)["rack"].source)
    assert found.value.hint.startswith("scale=0.001 if all files are in millimetres")
    line = re.search(r"the line (.*) at the top of objects\.toml", found.value.hint)
    sizes = {
        name: size_of(plan)
        for name, plan in planned(folder, f'{line[1]}\n[default]\nup = "z"\n').items()
    }
    assert sizes.pop("rack") == [0.1, 0.08, 0.06]
    assert all(size == list(SIZE) for size in sizes.values())
