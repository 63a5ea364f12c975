"""SDF: poses, frames, forms, materials, masses, and the folders of Gazebo's models."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source
from cluttergen_jax.importing.readers.materials import GREY

BOX = "<geometry><box><size>0.1 0.06 0.04</size></box></geometry>"


def visual(inside=BOX, name="v"):
    return f'<visual name="{name}">{inside}</visual>'


def mesh(uri="model://cup/meshes/cup.obj", more=""):
    return f"<geometry><mesh><uri>{uri}</uri>{more}</mesh></geometry>"


def model(inside, name="cup"):
    return f'<model name="{name}">{inside}</model>'


def link(inside, name="a", more=""):
    return f'<link name="{name}">{more}{inside}</link>'


def write(folder, text, config="Café Cup", file="model.sdf", root="sdf"):
    """A folder as Gazebo has it: `model.sdf`, `model.config`, a mesh of 20 x 40 x 60 mm with uv."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    (folder / file).write_text(f'<?xml version="1.0" ?><{root} version="1.7">{text}</{root}>')
    if config:
        text = f'<model><name>{config}</name><sdf version="1.7">{file}</sdf></model>'
        (folder / "model.config").write_text(text)
    box = trimesh.creation.box((0.02, 0.04, 0.06))
    flat = trimesh.visual.TextureVisuals(uv=np.full((len(box.vertices), 2), 0.5))
    trimesh.Trimesh(box.vertices, box.faces, visual=flat, process=False).export(
        folder / "meshes" / "cup.obj",
        include_texture=True,
        write_texture=False,
        mtl_name="none.mtl",
    )
    return folder


def save_image(path, colour):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (4, 4), colour).save(path)


def read(folder, text, **options):
    (shape,) = read_source(write(folder / "cup", text, **options))
    return shape


def bounds(pieces):
    return join_meshes([piece.mesh for piece in pieces]).bounds


def test_poses_frames_and_nested_models_put_links_where_they_belong(tmp_path):
    text = model(
        "<pose>0 0 0 0 0 1.5707963267948966</pose>"
        '<frame name="f" attached_to="a"><pose degrees="true">0 0.5 0 90 0 0</pose></frame>'
        + link(visual(), "a", "<pose>0 0 1 0 0 0</pose>")
        + link(
            visual(),
            "b",
            '<pose relative_to="f" rotation_format="quat_xyzw">0 0 0.2 0 0 0 1</pose>',
        )
        + '<joint name="j" type="revolute"><child>a</child><pose>0.3 0 0 0 0 0</pose></joint>'
        + f'<model name="lid"><pose relative_to="j">0 0 0.1 0 0 0</pose>{link(visual(), "c")}</model>'
    )
    shape = read(tmp_path, text)
    at = [piece.mesh.bounds.mean(0) for piece in shape.pieces]
    # By hand, before the model's quarter turn: a (0 0 1), b (0 0.5-0.2 1), c (0.3 0 1.1).
    np.testing.assert_allclose(at, [[0, 0, 1], [-0.3, 0, 1], [0, 0.3, 1.1]], atol=1e-9)
    size = [np.ptp(piece.mesh.bounds, axis=0) for piece in shape.pieces]
    np.testing.assert_allclose(
        size, [[0.06, 0.1, 0.04], [0.04, 0.1, 0.06], [0.06, 0.1, 0.04]], atol=1e-9
    )
    assert shape.notes[0] == "frozen joints: 'j' (revolute) at 0 degrees"


def test_a_pose_may_be_that_of_a_frame_inside(tmp_path):
    """`placement_frame`: the frame, not the model, is where the pose says."""
    frame = '<frame name="grip"><pose>0 0 0.5 0 0 0</pose></frame>'
    inner = '<model name="lid" placement_frame="grip"><pose>0 0.2 1 0 0 0</pose>{}{}</model>'
    inner = inner.format(frame, link(visual(), "c"))
    outer = '<frame name="f"><pose relative_to="lid">0 0 0.1 0 0 0</pose></frame>'
    beside = link(visual(), "b", '<pose relative_to="f">1 0 0 0 0 0</pose>')
    text = model(link(visual(), "a") + inner + outer + beside)
    text = text.replace('name="cup"', 'name="cup" placement_frame="f"')
    shape = read(tmp_path, text)
    at = np.array([piece.mesh.bounds.mean(0) for piece in shape.pieces])
    # The lid is at (0 0.2 0.5), f at (0 0.2 0.6); the model is put so that f is at the origin.
    expected = np.array([[0, 0, 0], [1, 0.2, 0.6], [0, 0.2, 0.5]]) - [0, 0.2, 0.6]
    np.testing.assert_allclose(at[np.lexsort(at.T)], expected[np.lexsort(expected.T)], atol=1e-9)


FORMS = {
    "<box><size>0.1 0.06 0.04</size></box>": (0.1, 0.06, 0.04),
    "<cylinder><radius>0.05</radius><length>0.2</length></cylinder>": (0.1, 0.1, 0.2),
    "<capsule><radius>0.05</radius><length>0.2</length></capsule>": (0.1, 0.1, 0.3),
    "<sphere><radius>0.05</radius></sphere>": (0.1, 0.1, 0.1),
    "<ellipsoid><radii>0.05 0.04 0.03</radii></ellipsoid>": (0.1, 0.08, 0.06),
    "<mesh><uri>meshes/cup.obj</uri><scale>2 -1 1</scale></mesh>": (0.04, 0.04, 0.06),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_have_their_size_seen_or_colliding(tmp_path, form):
    inside = f"<geometry>{form}</geometry>"
    shape = read(
        tmp_path, model(link(f'<collision name="c">{inside}</collision>' + visual(inside)))
    )
    np.testing.assert_allclose(np.ptp(bounds(shape.pieces), axis=0), FORMS[form], atol=5e-4)
    assert join_meshes([piece.mesh for piece in shape.pieces]).volume > 0
    assert len(shape.parts) == 1
    only = read(tmp_path, model(link(f'<collision name="c">{inside}</collision>')), root="gazebo")
    np.testing.assert_allclose(bounds(only.pieces), bounds(shape.pieces))


WRONG = {
    "<box><size>0.1</size></box>": "<box><size>0.1</size>",
    "<box><size>0.1 0.2 -1</size></box>": "<box><size>0.1 0.2 -1</size>",
    "<cylinder><radius>1</radius></cylinder>": "a <cylinder> without <length>",
    "<sphere><radius>wide</radius></sphere>": "<sphere><radius>wide</radius>",
    "<mesh><uri>meshes/mug.obj</uri></mesh>": "names mesh file 'meshes/mug.obj', which is not there",
    "<mesh><uri></uri></mesh>": "a <mesh> that names no file",
    "<mesh><uri>meshes/cup.obj</uri><submesh><name>lid</name></submesh></mesh>": "<submesh> 'lid'",
    "<polyline><height>1</height></polyline>": "geometry <polyline>",
}


@pytest.mark.parametrize("form", WRONG)
def test_wrong_forms_name_file_and_element(tmp_path, form):
    with pytest.raises(AssetError) as caught:
        read(tmp_path, model(link(visual(f"<geometry>{form}</geometry>"))))
    assert "model.sdf" in str(caught.value)
    assert WRONG[form] in str(caught.value)


SCRIPT = """// material Cup/Paint {
material Cup/Base
{
  technique { pass {
    diffuse 0.2 0.4 0.6 1
  } }
}
material Cup/Paint : Cup/Base
{
  technique
  {
    pass { ambient 0 0 0
      texture_unit
      {
        texture paint.png
      }
    }
  }
}
"""


def material(inside):
    return f"<material>{inside}</material>"


def script(name):
    uris = "<uri>model://cup/materials/scripts</uri><uri>model://cup/materials/textures</uri>"
    return material(f"<script>{uris}<name>{name}</name></script>")


def test_materials_give_colours_and_images(tmp_path):
    folder = tmp_path / "cup"
    save_image(folder / "materials" / "textures" / "paint.png", (10, 20, 30))
    (folder / "materials" / "scripts").mkdir()
    (folder / "materials" / "scripts" / "cup.material").write_text(SCRIPT)
    albedo = material(
        "<pbr><metal><albedo_map>materials/textures/paint.png</albedo_map></metal></pbr>"
    )
    for look in (script("Cup/Paint"), albedo):
        (piece,) = read(tmp_path, model(link(visual(mesh() + look)))).pieces
        assert piece.texture is not None
        np.testing.assert_allclose(piece.mean_rgba[:3], np.array([10, 20, 30]) / 255, atol=1e-3)
    colours = {
        material("<diffuse>1 0 0 1</diffuse>"): (1, 0, 0, 1),
        material("<ambient>0 1 0</ambient>"): (0, 1, 0, 1),
        material("<diffuse>1 0 0 1</diffuse>") + "<transparency>0.25</transparency>": (
            1,
            0,
            0,
            0.75,
        ),
        script("Cup/Base"): (0.2, 0.4, 0.6, 1),
        script("Gazebo/Blue"): (0, 0, 1, 1),
        script("Cup/Glaze"): GREY,
    }
    for look, rgba in colours.items():
        shape = read(tmp_path, model(link(visual(BOX + look))))
        assert shape.pieces[0].rgba == pytest.approx(rgba), look
    assert "material 'Cup/Glaze' is named and nowhere defined" in shape.notes


HEAVY = visual() + "<inertial><mass>0.2</mass></inertial>"


def test_links_of_one_name_in_two_models_both_weigh(tmp_path):
    inner = [model(link(HEAVY), name) for name in ("left", "right")]
    assert read(tmp_path, model("".join(inner))).stated.body.mass == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (link(HEAVY), "two <link> are called 'a'"),
        (
            "<joint name='j'><parent>a</parent><child>b</child></joint>",
            "joint 'j' has the child 'b'",
        ),
        (
            "<joint name='j'><parent>c::d</parent><child>a</child></joint>",
            "joint 'j' has the parent 'c::d'",
        ),
    ],
)
def test_links_of_one_name_and_joints_of_none_are_refused(tmp_path, more, told):
    with pytest.raises(AssetError, match=told):
        read(tmp_path, model(link(HEAVY) + more))
