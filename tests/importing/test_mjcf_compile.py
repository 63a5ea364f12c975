"""MJCF files that MuJoCo stops at: what is mended, what is said of it, and what is left to MuJoCo."""

import mujoco
import numpy as np
import pytest

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source
from cluttergen_jax.importing.readers.mjcf_compile import compile_with_notes
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene_with_notes
from tests.helpers.cases import CASES

BRACKET = CASES / "24_mjcf_flat_visual"
SQUARE = 'vertex="0 0 0 .1 0 0 .1 .1 0 0 .1 0" face="0 1 2 0 2 3"'
LINE = 'vertex="0 0 0 .1 0 0 .2 0 0 .3 0 0" face="0 1 2 0 2 3"'
UNSEEN = 'contype="0" conaffinity="0"'
BALL = '<geom size=".1"/>'


def write(path, inside, asset="", rest=""):
    text = f"<asset>{asset}</asset><worldbody>{inside}</worldbody>{rest}"
    path.write_text(f"<mujoco>{text}</mujoco>")
    return path


def free(inside):
    return f'<body name="thing"><freejoint/>{inside}</body>'


@pytest.mark.parametrize("name", ["bracket_label", "bracket_oldlabel"])
def test_a_label_without_a_volume_is_seen(name):
    (shape,) = read_source(BRACKET / f"{name}.xml")
    assert sorted(piece.rgba for piece in shape.pieces)[-1] == (1.0, 1.0, 0.0, 1.0)
    assert len(shape.pieces) == 2
    assert shape.stated.body.mass == pytest.approx({"bracket_label": 0.012}.get(name, 0.05))
    # MuJoCo reads the first, whose label is a shell by the file; the second is mended, which is told.
    assert len(shape.notes) == (name == "bracket_oldlabel")


def test_the_same_is_drawn_and_judged_with_a_note():
    path = BRACKET / "bracket_oldlabel.xml"
    scene, notes = read_mjcf_scene_with_notes(path)
    assert len(scene.objects[0].pieces) == 2
    model, of_judge = compile_with_notes(path, is_simulated=True)
    assert "shells without mass: 'lab'" in notes[0]
    assert of_judge == notes
    assert model.body_mass[1] == pytest.approx(0.05)


def test_a_file_that_compiles_is_left_as_it_is(tmp_path):
    path = write(
        tmp_path / "a.xml",
        free(BALL),
        "<texture name='t' type='2d' builtin='flat' width='8' height='8'/>",
    )
    model, notes = compile_with_notes(path)
    whole = mujoco.MjModel.from_xml_path(str(path))
    assert notes == ()
    assert model.body_mass.tobytes() == whole.body_mass.tobytes()


@pytest.mark.parametrize("inertia", ["legacy", "exact", "convex"])
@pytest.mark.parametrize("mass", ["", 'mass="0"', 'mass="0.3"'])
def test_what_is_flat_and_only_seen_adds_no_mass_of_its_own(tmp_path, inertia, mass):
    geom = f'<geom type="mesh" mesh="m" {UNSEEN} {mass}/>'
    path = write(
        tmp_path / "a.xml", free(BALL + geom), f'<mesh name="m" {SQUARE} inertia="{inertia}"/>'
    )
    model, notes = compile_with_notes(path, is_simulated=True)
    ball = 1000 * 4 / 3 * np.pi * 0.1**3
    assert model.body_mass[1] == pytest.approx(ball + (0.3 if "0.3" in mass else 0), rel=1e-6)
    assert model.ngeom == 2
    assert len(notes) == 1


def test_a_flat_mesh_that_is_to_collide_is_seen_where_nothing_is_simulated(tmp_path):
    path = write(
        tmp_path / "a.xml",
        free(f'{BALL}<geom type="mesh" mesh="m"/>'),
        f'<mesh name="m" {SQUARE}/>',
    )
    model, notes = compile_with_notes(path)
    assert model.ngeom == 2
    assert "collide with nothing: 'm'" in notes[0]
    with pytest.raises(AssetError, match="coplanar"):
        compile_with_notes(path, is_simulated=True)


def test_a_mesh_without_a_surface_is_left_out_with_a_note(tmp_path):
    geom = f'<geom type="mesh" mesh="m" {UNSEEN}/>'
    path = write(tmp_path / "a.xml", free(BALL + geom), f'<mesh name="m" {LINE}/>')
    model, notes = compile_with_notes(path)
    assert model.ngeom == 1
    assert "left out" in notes[0]


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ('<geom size=".05" mass="0"/>', "no mass"),
        ('<inertial pos="0 0 0" mass="1" diaginertia="1 1 5"/><geom size=".05"/>', "inertia"),
        (
            '<inertial pos="0 0 0" mass="1" fullinertia="-1 1 1 0 0 0"/><geom size=".05"/>',
            "inertia",
        ),
    ],
)
def test_masses_matter_where_a_body_moves_in_a_simulation_alone(tmp_path, link, said):
    hinged = write(tmp_path / "a.xml", free(f'{BALL}<body name="lid"><joint/>{link}</body>'))
    _, notes = compile_with_notes(hinged)
    assert said in notes[0]
    assert "'lid'" in notes[0]
    with pytest.raises(AssetError, match=r"mass and inertia|inertia must"):
        compile_with_notes(hinged, is_simulated=True)
    fixed = write(tmp_path / "b.xml", f'{free(BALL)}<body name="shelf">{link}</body>')
    model, _ = compile_with_notes(fixed, is_simulated=True)
    assert model.nbody == 3
    # What is said of a mass that stands for nothing is no statement of the file.
    (shape,) = read_source(hinged)
    ball = 1000 * 4 / 3 * np.pi * 0.1**3
    assert shape.stated.body.mass == pytest.approx(ball + (0 if said == "no mass" else 1), rel=1e-6)


def test_attributes_of_older_versions_are_read_in_included_files_too(tmp_path):
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "body.xml").write_text(
        f'<mujocoinclude><camera orthographic="true"/>{free(BALL)}</mujocoinclude>'
    )
    path = tmp_path / "a.xml"
    path.write_text(
        '<mujoco><compiler exactmeshinertia="true"/><option apirate="100" mpr_iterations="60">'
        '<flag passive="disable"/></option><worldbody><include file="part/body.xml"/></worldbody></mujoco>'
    )
    model, notes = compile_with_notes(path)
    assert len(notes) == 5
    assert model.opt.ccd_iterations == 60
    assert model.opt.disableflags & int(
        mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER
    )
    assert model.ncam == 1


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ('<geom size=".1" oops="1"/>', "oops"),
        (f'<geom type="mesh" mesh="gone" {UNSEEN}/>', "gone"),
        ('<geom size="-1"/>', "size"),
    ],
)
def test_what_does_matter_is_mujocos_own_error(tmp_path, inside, said):
    with pytest.raises(AssetError, match=said):
        compile_with_notes(write(tmp_path / "a.xml", free(inside)))


def test_several_faults_of_one_file_are_all_mended_and_told(tmp_path):
    asset = "".join(f'<mesh name="m{i}" {SQUARE}/>' for i in range(4))
    asset += '<texture name="t" type="2d" file="gone.png"/><material name="w" texture="t"/>'
    geoms = "".join(f'<geom type="mesh" mesh="m{i}" material="w" {UNSEEN}/>' for i in range(4))
    path = write(
        tmp_path / "a.xml",
        free(f'{BALL}{geoms}<body><joint/><geom size=".01" mass="0"/></body>'),
        asset,
    )
    model, notes = compile_with_notes(path)
    assert model.ngeom == 6
    assert len(notes) == 3
    assert "'m0', 'm1', 'm2', 'm3'" in " ".join(notes)


def test_a_mesh_that_is_not_there_is_named_and_is_no_other_format(tmp_path):
    path = write(
        tmp_path / "a.xml", free('<geom type="mesh" mesh="gone"/>'), '<mesh file="gone.obj"/>'
    )
    with pytest.raises(AssetError, match=r"gone\.obj.*Try: restoring the file") as caught:
        compile_with_notes(path)
    assert "Allowed" not in str(caught.value)
