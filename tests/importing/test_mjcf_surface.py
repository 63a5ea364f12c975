"""What of an MJCF body is the object: what MuJoCo draws, never a helper, a sticker or a ball for a plane."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source
from cluttergen_jax.importing.readers.mjcf import read_mjcf
from cluttergen_jax.importing.readers.source import make_source
from cluttergen_jax.scene.mjcf_file import read_mjcf_scene

CASES = Path(__file__).parents[1] / "cases" / "import"
GHOST = "contype='0' conaffinity='0'"


def size_of(shape):
    """Millimetres."""
    return 1000 * np.ptp(join_meshes([piece.mesh for piece in shape.pieces]).vertices, axis=0)


def read_body(tmp_path, geoms, more=""):
    path = tmp_path / "thing.xml"
    path.write_text(
        f"<mujoco>{more}<worldbody><body name='thing'>{geoms}</body></worldbody></mujoco>"
    )
    (shape,) = read_source(path)
    return shape


@pytest.mark.parametrize(
    ("file", "sizes", "num_parts"),
    [
        ("02_mjcf_not_solid/hfield.xml", [(100, 100, 40)], [None]),
        ("02_mjcf_not_solid/sdf.xml", [(130, 130, 30)], [None]),
        ("02_mjcf_not_solid/scene_with_floor.xml", [(800, 600, 40), (60, 60, 60)], [1, 1]),
        ("04_mjcf_region_box/region.xml", [(60, 60, 100)], [1]),
        ("05_mjcf_decal/decal.xml", [(80, 61, 160)], [1]),
    ],
)
def test_files_that_were_read_wrong(file, sizes, num_parts):
    shapes = read_source(CASES / file)
    for shape, size, count in zip(shapes, sizes, num_parts, strict=True):
        np.testing.assert_allclose(size_of(shape), size, atol=0.1)
        assert (None if shape.parts is None else len(shape.parts)) == count


def test_what_is_drawn_and_in_which_colour_is_as_mujoco_has_it(tmp_path):
    """Alpha 0 of geom or material, groups, and whose colour holds: each against MuJoCo's own drawing."""
    materials = "<material name='none' rgba='1 1 0 0'/><material name='red' rgba='1 0 0 1'/>"
    looks = [
        f"{material} {colour} group='{group}' {GHOST}"
        for material in ("", "material='none'", "material='red'")
        for colour in ("", "rgba='0 0 1 1'", "rgba='0 0 1 0'", "rgba='0 .5 0 .3'")
        for group in (0, 2, 3)
    ]
    # Each geom has a size of its own, by which it is found again.
    geoms = "".join(
        f"<geom type='box' size='.01 .01 {0.01 + 0.001 * i}' {look}/>"
        for i, look in enumerate(looks)
    )
    shape = read_body(tmp_path, geoms, f"<asset>{materials}</asset>")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "thing.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 100)
    mujoco.mjv_updateScene(
        model,
        data,
        mujoco.MjvOption(),
        None,
        mujoco.MjvCamera(),
        mujoco.mjtCatBit.mjCAT_ALL.value,
        scene,
    )
    drawn = {each.objid: each.rgba for each in scene.geoms[: scene.ngeom] if each.rgba[3] > 0}
    heights = [500 * np.ptp(piece.mesh.vertices[:, 2]) for piece in shape.pieces]
    found = {
        round(height - 10): piece.rgba for height, piece in zip(heights, shape.pieces, strict=True)
    }
    assert found.keys() == drawn.keys()
    for index, rgba in found.items():
        np.testing.assert_allclose(rgba, drawn[index], atol=1e-6)


CARTON = "<geom name='carton' type='box' size='.04 .03 .08' rgba='.6 .4 .2 1'/>"
BALL = f"<geom type='sphere' size='.03' {GHOST} rgba='1 0 0 1' group='1'/>"
GLASS = "<geom type='cylinder' size='.03 .05'/>"
WATER = f"<geom type='cylinder' size='.027 .03' pos='0 0 -.017' {GHOST}/>"
REGION = f"<geom type='box' size='.2 .2 .2' {GHOST}"
LABEL = f"<body pos='0 -.0305 0'><geom type='box' size='.02 .0005 .02' {GHOST}/></body>"
DRAWER = "<body pos='0 .1 0'><geom type='box' size='.02 .04 .02'/></body>"
STICKERS = "".join(
    f"<geom type='box' size='{size}' pos='{at}' {GHOST} rgba='1 1 1 1'/>"
    for size, at in [
        (".03 .0005 .06", "0 .0305 0"),
        (".03 .0005 .06", "0 -.0305 0"),
        (".0005 .02 .06", ".0405 0 0"),
        (".0005 .02 .06", "-.0405 0 0"),
        (".03 .02 .0005", "0 0 .0805"),
        (".03 .02 .0005", "0 0 -.0805"),
    ]
)
BODIES = {
    "stickers on all sides": (CARTON + STICKERS, 7, (82, 62, 162)),
    "a sticker on a body of its own": (LABEL + CARTON, 2, (80, 61, 160)),
    "a box around a ball": (BALL + "<geom type='box' size='.03 .03 .03'/>", 1, (60, 60, 60)),
    "a box inside a ball": (BALL + "<geom type='box' size='.017 .017 .017'/>", 1, (60, 60, 60)),
    "a box in group 3": (BALL + "<geom type='box' size='.03 .03 .2' group='3'/>", 1, (60, 60, 60)),
    "a box of alpha 0": (
        BALL + "<geom type='box' size='.03 .03 .2' rgba='1 1 1 0'/>",
        1,
        (60, 60, 60),
    ),
    "a drawer that has no other surface": (BALL + DRAWER, 2, (60, 170, 60)),
    "a glass and what it holds": (GLASS + WATER, 2, (60, 60, 100)),
    "a region of alpha 0": (CARTON + REGION + " rgba='0 1 0 0'/>", 1, (80, 60, 160)),
    "a region in group 4": (CARTON + REGION + " group='4'/>", 1, (80, 60, 160)),
    "a plane": (CARTON + "<geom type='plane' size='1 1 1'/>", 1, (80, 60, 160)),
}


@pytest.mark.parametrize("case", BODIES)
def test_what_is_the_object(tmp_path, case):
    geoms, num_pieces, size = BODIES[case]
    shape = read_body(tmp_path, geoms)
    assert len(shape.pieces) == num_pieces
    np.testing.assert_allclose(size_of(shape), size, atol=0.5)


def test_what_is_left_out_or_taken_is_said(tmp_path):
    shape = read_body(tmp_path, "<geom name='ground' type='plane' size='1 1 1'/>" + CARTON)
    assert shape.notes == ("left out, as planes have no inside: 'ground'",)
    shape = read_body(tmp_path, BALL + "<geom type='box' size='.03 .03 .03'/>")
    assert shape.notes == ("taken for collision alone, as what is seen covers them: a box",)
    shape = read_body(tmp_path, CARTON + REGION + " mass='.3' group='4'/>")
    assert shape.notes[-1] == "what is left out weighs 0.3 kg: it counts, as in MuJoCo"
    (shape,) = read_source(CASES / "04_mjcf_region_box" / "region.xml")
    assert shape.notes == ("left out, as they are not seen and do not collide: 'reg_bbox'",)


def test_what_lies_in_the_world_is_of_furniture_and_is_said_of_an_object(tmp_path):
    top = "<geom type='box' size='.4 .3 .02' pos='0 0 .7'/>"
    drawer = "<body name='drawer' pos='0 0 .6'><joint name='rail' type='slide'/>{}</body>"
    path = tmp_path / "desk.xml"
    path.write_text(f"<mujoco><worldbody>{top}{drawer.format(CARTON)}</worldbody></mujoco>")
    whole = read_mjcf(make_source(path, "mjcf"), opened={})
    alone = read_mjcf(make_source(path, "mjcf"))
    assert (len(whole.pieces), len(alone.pieces)) == (2, 1)
    assert "left out, as they lie in the world beside the body: 1 geoms" in alone.notes


def test_the_ground_under_a_grid_of_heights_is_where_mujoco_has_it(tmp_path):
    heights = np.random.default_rng(0).uniform(size=(5, 4)).round(3)
    path = tmp_path / "hill.xml"
    path.write_text(
        f"""<mujoco><asset><hfield name="h" nrow="5" ncol="4" size=".06 .05 .03 .01"
          elevation="{" ".join(map(str, heights.ravel()))}"/></asset>
          <worldbody><body><geom type="hfield" hfield="h"/></body></worldbody></mujoco>"""
    )
    (shape,) = read_source(path)
    mesh = shape.pieces[0].mesh
    spec = mujoco.MjSpec.from_file(str(path))
    made = spec.add_mesh(name="ours")
    made.uservert = mesh.vertices.ravel()
    made.userface = mesh.faces.ravel()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ours", group=1)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = np.random.default_rng(1).uniform((-0.059, -0.049), (0.059, 0.049), (200, 2))
    for at in points:
        theirs, ours = (
            mujoco.mj_ray(model, data, [*at, 0.5], [0, 0, -1], groups, 1, -1, np.zeros(1, np.int32))
            for groups in np.eye(6, dtype=np.uint8)[:2]
        )
        assert ours == pytest.approx(theirs, abs=1e-6)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
    assert mesh.volume > 0.12 * 0.10 * 0.01


def test_a_scene_shows_no_floor_as_a_ball_and_no_target(tmp_path):
    scene = read_mjcf_scene(CASES / "02_mjcf_not_solid" / "scene_with_floor.xml")
    table = join_meshes([piece.mesh for piece in scene.support.pieces])
    np.testing.assert_allclose(np.ptp(table.vertices, axis=0), (0.8, 0.6, 0.04), atol=1e-6)
    path = tmp_path / "scene.xml"
    path.write_text(
        f"""<mujoco><worldbody><geom type="plane" size="0 0 1"/>
          <body name="carton" pos="0 0 .08"><freejoint/>{CARTON}{STICKERS}</body>
          <body name="goal"><freejoint/><geom size=".3" rgba="0 1 0 0" {GHOST}/></body></worldbody>
        </mujoco>"""
    )
    scene = read_mjcf_scene(path)
    assert scene.names == ("carton",)
    assert len(scene.objects[0].pieces) == 7
    assert scene.support.pieces == ()
    path.write_text(
        path.read_text().replace(CARTON + STICKERS, f"<geom size='.1' group='3' {GHOST}/>")
    )
    with pytest.raises(AssetError, match="nothing of them is seen or collides"):
        read_mjcf_scene(path)
