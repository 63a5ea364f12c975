"""What is told of objects and can be chosen by, against bodies of known size that come in by `import`."""

import json
import re
import shutil
from dataclasses import replace

import msgspec
import mujoco
import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.body import turned_variants
from cluttergen_jax.assets.facts import ObjectFacts, chosen_names, object_volume
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.parts import hull_of
from cluttergen_jax.assets.pool import EMBEDDED, embedded_root, find_pool, read_pool, user_root
from cluttergen_jax.cli.main import main
from cluttergen_jax.scene.export.molmospaces import asset_json
from cluttergen_jax.scene.export.usd import metadata
from cluttergen_jax.schema import checked_record, with_checksum
from tests.helpers.imports import made_here

DENSITY = 500.0
RING = np.pi * (0.06**2 - 0.04**2) * 0.03
WALLED = 0.1 * 0.08 * 0.06 - 0.09 * 0.07 * 0.055
# Sides along x, y, z in metres, and cubic metres of material.
BODIES = {
    "box": ((0.10, 0.06, 0.04), 0.10 * 0.06 * 0.04),
    "cylinder": ((0.08, 0.08, 0.05), np.pi * 0.04**2 * 0.05),
    "ring": ((0.12, 0.12, 0.03), RING),
    "shell": ((0.10, 0.08, 0.06), WALLED),
    "two": ((0.10, 0.06, 0.04), 0.10 * 0.06 * 0.04),
}


def moved(mesh, *at):
    return mesh.apply_translation(at)


def bodies():
    inside = moved(trimesh.creation.box((0.09, 0.07, 0.06)), 0, 0, 0.005)
    return {
        "box": trimesh.creation.box((0.10, 0.06, 0.04)),
        "cylinder": trimesh.creation.cylinder(0.04, 0.05, sections=64),
        "ring": trimesh.creation.annulus(0.04, 0.06, 0.03, sections=64),
        "shell": trimesh.boolean.difference([trimesh.creation.box((0.10, 0.08, 0.06)), inside]),
        # Two solids that overlap: what is in both counts once.
        "two": trimesh.util.concatenate(
            [
                moved(trimesh.creation.box((0.07, 0.06, 0.04)), -0.015, 0, 0),
                moved(trimesh.creation.box((0.06, 0.06, 0.04)), 0.02, 0, 0),
            ]
        ),
    }


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A user's folder with a pool of the bodies, as `import` makes it."""
    folder = tmp_path_factory.mktemp("known")
    (folder / "files").mkdir()
    for name, mesh in bodies().items():
        mesh.export(folder / "files" / f"{name}.obj")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLUTTERGEN_HOME", str(folder / "home"))
        patch.setattr("cluttergen_jax.importing.run._outcomes", made_here)
        line = ["import", str(folder / "files"), "--pool", "known", "--trials", "4", "--jobs", "1"]
        terms = ["--up", "file", "--licence", "CC0-1.0", "--density", str(DENSITY)]
        assert main([*line, *terms, "--no-progress"]) == 0
    return folder / "home"


@pytest.fixture
def pool(home, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(home))
    return find_pool("known")


def chosen(capsys, condition, pool="known"):
    """The objects that `pool show --objects` lists."""
    assert main(["pool", "show", pool, "--objects", condition]) == 0
    lines = capsys.readouterr().out.splitlines()
    first = next(place for place, line in enumerate(lines) if line.startswith("object ")) + 1
    return {line.split()[0] for line in lines[first:]} & set(find_pool(pool).names)


@pytest.mark.parametrize("name", BODIES)
def test_every_number_is_that_of_the_body(pool, capsys, name):
    (x, y, z), volume = BODIES[name]
    numbers = {
        "x": x,
        "y": y,
        "height": z,
        "width": max(x, y),
        "depth": min(x, y),
        "volume": volume,
    }
    numbers["mass"] = DENSITY * volume
    for field, value in numbers.items():
        assert name in chosen(capsys, f"{field}>{0.97 * value} and {field}<{1.03 * value}"), field
    asset = pool[name]
    assert name in chosen(capsys, f"parts={len(asset.parts)} and flagged=0")


def test_every_text_is_that_of_the_file(pool, capsys):
    assert chosen(capsys, "name=ring") == chosen(capsys, "label=ring") == {"ring"}
    assert chosen(capsys, "licence=cc0*") == set(BODIES)
    assert chosen(capsys, "source=*/shell.obj") == {"shell"}


def test_a_limit_of_volume_divides_a_pool(pool, capsys):
    small = {name for name, (_, volume) in BODIES.items() if volume < 0.0002}
    assert small
    assert chosen(capsys, "volume<0.0002") == small
    assert chosen(capsys, "volume>=0.0002") == set(BODIES) - small


@pytest.mark.parametrize("command", [["pool", "show"], ["inspect"]], ids=" ".join)
def test_tables_have_size_and_mass(pool, capsys, command):
    assert main([*command, "known"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    for name, (sides, volume) in BODIES.items():
        x, y, z, _scale, mass = (float(each) for each in re.findall(r"\d[\d.]*", rows[name])[:5])
        np.testing.assert_allclose([x, y, z], 1000 * np.array(sides), rtol=0.03)
        assert mass == pytest.approx(DENSITY * volume, abs=2e-3)


@pytest.mark.parametrize("name", BODIES)
def test_what_exports_say_of_a_body(pool, name):
    sides, volume = BODIES[name]
    asset = pool[name]
    library = json.loads(asset_json(asset))
    ready = metadata(asset)
    np.testing.assert_allclose(list(library["boundingBox"].values()), sides, rtol=0.03)
    np.testing.assert_allclose(ready["asset_extents"], sides, rtol=0.03)
    assert library["mass"] == ready["mass"] == pytest.approx(DENSITY * volume, rel=0.03)
    folder = user_root() / "known" / name
    model = mujoco.MjModel.from_xml_path(str(folder / "object.xml"))
    assert model.body_mass.sum() == pytest.approx(DENSITY * volume, rel=0.03)


def test_facts_of_an_older_kind_are_measured_anew(pool, home, tmp_path, monkeypatch):
    """A `pool.json` of earlier versions says that every volume is zero."""
    old = shutil.copytree(user_root() / "known", tmp_path / "known")
    record = checked_record((old / "pool.json").read_bytes())
    assert [each["volume"] for each in record["facts"]] == [each.volume for each in pool.facts]
    del record["facts_format"]
    for each in record["facts"]:
        each["volume"] = 0.0
    (old / "pool.json").write_text(json.dumps(with_checksum(record)))
    # Of a large pool no object is read while its facts are known.
    monkeypatch.setattr("cluttergen_jax.assets.pool.MOST_READ", 2)
    assert read_pool(old).facts == pool.facts
    assert find_pool(old).hash == pool.hash


def test_the_same_after_it_was_turned(pool):
    """A body's volume does not depend on its pose; to 1 %, since bottoms are made flat."""
    asset = pool["shell"]
    turned = next(turned_variants(asset, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])))
    assert object_volume(turned) == pytest.approx(object_volume(asset), rel=0.01)


def test_an_open_surface_has_the_volume_of_its_parts(pool):
    box = pool["box"]
    (piece,) = box.pieces
    open_box = replace(
        box, pieces=(replace(piece, mesh=Mesh(piece.mesh.vertices, piece.mesh.faces[2:])),)
    )
    assert object_volume(open_box) == pytest.approx(0.10 * 0.06 * 0.04, rel=0.01)


@pytest.mark.parametrize("name", EMBEDDED)
def test_embedded_pools_keep_what_is_measured(name):
    pool = find_pool(name)
    record = checked_record((embedded_root() / "pools" / name / "pool.json").read_bytes())
    assert msgspec.convert(record["facts"], tuple[ObjectFacts, ...]) == pool.facts
    for asset, each in zip(pool.objects, pool.facts, strict=True):
        hull = hull_of(np.concatenate([piece.mesh.vertices for piece in asset.pieces])).volume
        assert 0.02 * hull < each.volume <= hull


def test_the_documentation_s_condition_divides_the_embedded_pools():
    facts = find_pool("all").facts
    small = chosen_names(facts, ["volume<0.001"], "all")
    large = chosen_names(facts, ["volume>=0.001"], "all")
    assert "mug" in small
    assert "toaster" in large
    assert {*small, *large} == {each.name for each in facts}
    assert not set(small) & set(large)
