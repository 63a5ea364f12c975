"""A stable pose that a file states is kept; others are turned as people put them, with the reason."""

import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.body import make_object
from cluttergen_jax.importing.readers import find_sources, read_shape
from cluttergen_jax.importing.readers.source import ReadOptions

Y_UP = trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0))

MODELS = {
    "urdf": """<robot name="thing"><link name="a"><visual><geometry><mesh filename="{mesh}"/>
        </geometry></visual></link></robot>""",
    "sdf": """<sdf version="1.7"><model name="thing"><link name="a"><visual name="v"><geometry><mesh>
        <uri>{mesh}</uri></mesh></geometry></visual></link></model></sdf>""",
    "xml": """<mujoco model="thing"><asset><mesh name="m" file="{mesh}"/></asset><worldbody>
        <body name="thing"><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>""",
}


def book():
    """A book on its lower edge, z up."""
    return trimesh.creation.box((0.05, 0.15, 0.21))


def lying_can():
    """A can that would roll away, z up."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    return trimesh.creation.cylinder(0.033, 0.1, sections=48).apply_transform(turn)


def lying_carton():
    """A carton on its side, where people put it on its end."""
    return trimesh.creation.box((0.07, 0.2, 0.07))


def written(folder, kind, mesh):
    """A file of that kind that states z up, or whose format does, where it has a place for it."""
    if kind in MODELS:
        mesh.export(folder / "mesh.obj")
        path = folder / f"thing.{kind}"
        path.write_text(MODELS[kind].format(mesh="mesh.obj"))
        return path
    path = folder / f"thing.{kind}"
    if kind == "dae":
        data = trimesh.exchange.dae.export_collada(mesh).decode()
        assert "<up_axis>" in data
        path.write_text(data.replace("Y_UP", "Z_UP"))
        return path
    (mesh.copy().apply_transform(Y_UP) if kind == "glb" else mesh).export(path)
    return path


def body_of(path, **options):
    (source,) = find_sources(path)
    return make_object(read_shape(source, ReadOptions(**options)))


def sides(asset):
    return 2 * asset.half_extents


@pytest.mark.parametrize("kind", [*MODELS, "glb", "dae"])
def test_a_stable_pose_that_a_file_states_is_kept(tmp_path, kind):
    asset = body_of(written(tmp_path, kind, lying_carton()))
    assert sides(asset)[2] == pytest.approx(0.07, abs=1e-3)
    (note,) = [each for each in asset.notes if "as its file states" in each]
    assert note.startswith("it stands as its file states (")
    assert "200 mm tall" in note


@pytest.mark.parametrize("kind", ["obj", "stl", "ply"])
def test_what_states_nothing_is_turned_as_people_put_it(tmp_path, kind):
    asset = body_of(written(tmp_path, kind, lying_carton()))
    assert sides(asset)[2] == pytest.approx(0.2, abs=1e-3)
    (note,) = [each for each in asset.notes if "as people put it" in each]
    assert note.endswith("its file does not say which way is up")


@pytest.mark.parametrize("kind", ["urdf", "glb"])
def test_a_stated_pose_that_does_not_stand_gives_way(tmp_path, kind):
    asset = body_of(written(tmp_path, kind, lying_can()))
    assert sides(asset)[2] == pytest.approx(0.1, abs=1e-3)
    (note,) = [each for each in asset.notes if "as people put it" in each]
    assert "it does not stand" in note


@pytest.mark.parametrize("kind", ["urdf", "obj"])
def test_a_pose_in_which_people_put_it_gets_no_note(tmp_path, kind):
    asset = body_of(written(tmp_path, kind, book()))
    assert sides(asset)[2] == pytest.approx(0.21, abs=1e-3)
    assert not [each for each in asset.notes if "turned" in each or "as its file states" in each]


def test_what_a_user_asks_for_goes_before_all(tmp_path):
    path = written(tmp_path, "obj", lying_carton())
    assert sides(body_of(path, up="z"))[2] == pytest.approx(0.07, abs=1e-3)
    assert sides(body_of(path, up="y"))[2] == pytest.approx(0.2, abs=1e-3)
    assert sides(body_of(path, up="file"))[2] == pytest.approx(0.07, abs=1e-3)
