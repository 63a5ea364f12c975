"""Roughness, metalness, maps of normals and transmission, read from every format that states them."""

import json
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.shape import Texture
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.importing.readers import read_source
from cluttergen_jax.importing.readers.finishes import is_normal_map
from cluttergen_jax.importing.readers.gltf import glb
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from tests.helpers import shiny, textured

METAL = {"metallicFactor": 1.0, "roughnessFactor": 0.1}
GLASS = "KHR_materials_transmission"


def read(path):
    """The finish of the only surface, its colour, and the notes."""
    (shape,) = read_source(path)
    (piece,) = shape.pieces
    return piece, shape.notes


def of_gltf(tmp_path, material, **more):
    return read(shiny.write_glb(tmp_path / "slab.glb", material, **more))


def of_mtl(tmp_path, *lines, **more):
    return read(shiny.write_obj(tmp_path / "in", *lines, **more))


def numbers(piece):
    """Roughness and metalness."""
    return pytest.approx((piece.finish.roughness, piece.finish.metallic), abs=1e-3)


def test_gltf_brings_numbers_and_maps(tmp_path):
    look = METAL | {"metallicRoughnessTexture": {"index": 1}, "baseColorFactor": [1, 0, 0, 1]}
    material = {"pbrMetallicRoughness": look, "normalTexture": {"index": 0}}
    piece, notes = of_gltf(tmp_path, material, images=(shiny.bumps(), shiny.gloss(0.5, 0.8)))
    assert notes == ()
    assert numbers(piece) == (0.1, 1.0)
    assert piece.texture is None
    assert piece.rgba == (1.0, 0.0, 0.0, 1.0)
    assert piece.finish.normal == Texture.of(shiny.bumps())
    # Red, of which glTF's map says nothing, is 1.
    assert {tuple(p) for p in np.asarray(piece.finish.orm.image).reshape(-1, 3)} == {
        (255, 128, 204)
    }
    # Its coordinates are those on which an image of colours would lie.
    upright = replace(piece, texture=Texture.of(textured.picture()), rgba=(1.0, 1.0, 1.0, 1.0))
    textured.assert_upright(upright)


def test_slopes_of_normals_are_scaled(tmp_path):
    material = {"normalTexture": {"index": 0, "scale": 0.5}}
    piece, _ = of_gltf(tmp_path, material, images=(shiny.bumps(),))
    normals = np.asarray(piece.finish.normal.image).reshape(-1, 3) / 127.5 - 1
    np.testing.assert_allclose(np.abs(normals[:, 0] / normals[:, 2]), 0.5 * 0.6 / 0.8, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=0.02)


@pytest.mark.parametrize(
    ("look", "expected"),
    [
        ({}, None),
        ({"baseColorFactor": [1, 0, 0, 1]}, None),
        ({"roughnessFactor": 0.3}, (0.3, 1.0)),
        ({"metallicFactor": 0.0}, (1.0, 0.0)),
        ({"roughnessFactor": 7, "metallicFactor": -1}, (1.0, 0.0)),
        ({"roughnessFactor": float("nan"), "metallicFactor": 0.5}, (0.65, 0.5)),
    ],
)
def test_numbers_of_gltf(tmp_path, look, expected):
    piece, notes = of_gltf(tmp_path, {"pbrMetallicRoughness": look})
    if expected is None:
        assert piece.finish is None
    else:
        assert numbers(piece) == expected
    is_wrong = any(not 0 <= each <= 1 for each in look.values() if not isinstance(each, list))
    assert any("clipped" in note or "left out" in note for note in notes) == is_wrong


def test_materials_of_one_name_are_told_apart(tmp_path):
    boxes = [trimesh.creation.box((0.05, 0.05, 0.05)) for _ in range(2)]
    for box, share in zip(boxes, (0.2, 0.7), strict=True):
        material = trimesh.visual.material.PBRMaterial(
            name="same", roughnessFactor=share, metallicFactor=0.0
        )
        box.visual = trimesh.visual.TextureVisuals(material=material)
        box.apply_translation([share, 0, 0])
    path = tmp_path / "two.glb"
    trimesh.Scene(boxes).export(str(path))
    pieces = read_mesh_file(path).pieces
    found = {round(float(each.mesh.vertices[:, 0].mean()), 3): each.finish for each in pieces}
    assert {where: finish.roughness for where, finish in found.items()} == {0.2: 0.2, 0.7: 0.7}


@pytest.mark.parametrize(("share", "alpha"), [(1.0, 0.3), (0.5, 0.65), (0, 1.0)])
def test_transmission_is_seen_as_alpha(tmp_path, share, alpha):
    extensions = {GLASS: {"transmissionFactor": share}}
    look = {"metallicFactor": 0.0, "roughnessFactor": 0.0}
    material = {"pbrMetallicRoughness": look, "extensions": extensions}
    used = {"extensionsUsed": [GLASS], "extensionsRequired": [GLASS]}
    piece, notes = of_gltf(tmp_path, material, **used)
    assert piece.finish.transmission == share
    assert piece.rgba[3] == pytest.approx(alpha)
    assert notes == ()


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ({"normalTexture": {"index": 0}}, "normal map"),
        ({"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}}}, "metalness"),
    ],
)
def test_a_map_that_is_no_image_is_said(tmp_path, material, said):
    piece, notes = of_gltf(tmp_path, material, images=(b"no image at all",))
    assert piece.finish is None or not piece.finish.images
    assert any(said in note and "cannot be read" in note for note in notes), notes


def test_maps_that_cannot_lie_on_the_surface_are_said(tmp_path):
    maps = {"normalTexture": {"index": 0}, "pbrMetallicRoughness": METAL}
    piece, notes = of_gltf(tmp_path / "a", maps, images=(shiny.bumps(),), with_uv=False)
    assert (piece.uv, piece.finish.images) == (None, ())
    assert any("texture coordinates" in note for note in notes)
    maps["normalTexture"] = {"index": 0, "texCoord": 1}
    piece, notes = of_gltf(tmp_path / "b", maps, images=(shiny.bumps(),))
    assert (piece.uv, piece.finish.images) == (None, ())
    assert any("other texture coordinates" in note for note in notes)


def test_colours_at_vertices_keep_the_finish(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    shade = np.clip(127.5 * (1 + ball.vertices / 0.05), 0, 255).astype(np.uint8)
    ball.visual.vertex_colors = np.column_stack([shade, np.full(len(shade), 255)])
    path = tmp_path / "ball.glb"
    ball.export(path)
    data = path.read_bytes()
    document = shiny.document_of(path)
    length = int.from_bytes(data[12:16], "little")
    document["materials"] = [{"pbrMetallicRoughness": METAL}]
    for primitive in document["meshes"][0]["primitives"]:
        primitive["material"] = 0
    path.write_bytes(glb(document, data[28 + length :]))
    piece, _ = read(path)
    assert numbers(piece) == (0.1, 1.0)
    assert len(np.unique(np.asarray(piece.texture.image).reshape(-1, 3), axis=0)) > 20


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (("Kd 1 0 0",), None),
        (("Kd 1 0 0", "Pr 0.1", "Pm 1"), (0.1, 1.0)),
        (("Kd 1 0 0", "Pr 0.1", "Ks 0 0 0", "Ns 10"), (0.1, 0.0)),
        # Blinn's exponent n is a roughness r of r^4 = 2 / (n + 2).
        (("Kd 1 0 0", "Ks 0.5 0.5 0.5", "Ns 30"), (0.5, 0.0)),
        (("Kd 1 0 0", "Ks 0 0 0", "Ns 30"), (1.0, 0.0)),
        # Blender writes 1000 (1 - r)^2.
        (("# Blender 4.2.0 MTL File: 'None'", "Kd 1 0 0", "Ks 0.5 0.5 0.5", "Ns 250"), (0.5, 0.0)),
        (("Kd 1 0 0", "Ks 1 1 1", "Ns 30", "illum 1"), (1.0, 0.0)),
        (("Kd 1 0 0", "Ks 1 1 1", "Ns 0"), (1.0, 0.0)),
        (("Kd 1 0 0", "Pr 7"), (1.0, 0.0)),
        (("Kd 1 0 0", "Pr nan", "Pm 1"), (0.65, 1.0)),
    ],
)
def test_numbers_of_mtl(tmp_path, lines, expected):
    piece, notes = of_mtl(tmp_path, *lines)
    assert piece.rgba == (1.0, 0.0, 0.0, 1.0)
    if expected is None:
        assert piece.finish is None
    else:
        assert numbers(piece) == expected
    is_wrong = "Pr 7" in lines or "Pr nan" in lines
    assert any("roughness" in note for note in notes) == is_wrong


@pytest.mark.parametrize(
    ("lines", "alpha"),
    [
        (("d 0.4",), 0.4),
        (("Tr 0.25",), 0.75),
        (("d 0.4", "Tr 0.25"), 0.4),
        # Some write Tr for what others call d: at its ends nobody knows.
        (("Tr 1",), 1.0),
        (("Tr 0",), 1.0),
    ],
)
@pytest.mark.parametrize("has_image", [True, False])
def test_transparency_of_mtl(tmp_path, lines, alpha, has_image):
    images = [("slab.png", textured.picture())] if has_image else []
    image = ["map_Kd slab.png"] if has_image else []
    piece, _ = of_mtl(tmp_path, "Kd 1 1 1", *lines, *image, images=images)
    assert piece.rgba[3] == pytest.approx(alpha, abs=0.003)


def test_maps_of_mtl(tmp_path):
    grey = [
        (f"{name}.png", Image.new("L", (8, 8), value)) for name, value in (("r", 51), ("m", 204))
    ]
    lines = ("Kd 1 1 1", "norm n.png", "map_Pr r.png", "map_Pm m.png", "Pr 0.9")
    piece, notes = of_mtl(tmp_path, *lines, images=[("n.png", shiny.bumps()), *grey])
    assert notes == ()
    assert piece.finish.normal == Texture.of(shiny.bumps())
    assert np.asarray(piece.finish.orm.image)[0, 0].tolist() == [255, 51, 204]
    assert numbers(piece) == (1.0, 1.0)
    assert piece.finish.without_maps.roughness == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("word", ["map_Bump", "bump"])
def test_bumps_of_mtl_are_normals_or_left_out(tmp_path, word):
    piece, notes = of_mtl(tmp_path / "n", f"{word} n.png", images=[("n.png", shiny.bumps())])
    assert (notes, piece.finish.normal) == ((), Texture.of(shiny.bumps()))
    ramp = Image.fromarray(np.tile(np.arange(256, dtype=np.uint8), (64, 1)))
    piece, notes = of_mtl(tmp_path / "h", f"{word} h.png", images=[("h.png", ramp)])
    assert piece.finish is None
    assert any("heights" in note for note in notes)


@pytest.mark.parametrize(
    ("images", "said"),
    [((), "not there"), ((("n.png", b"no image"),), "cannot be read as an image")],
)
def test_a_map_of_mtl_that_is_lost_is_said(tmp_path, images, said):
    piece, notes = of_mtl(tmp_path, "Pr 0.5", "norm n.png", images=images)
    assert (piece.finish.roughness, piece.finish.images) == (0.5, ())
    assert any("norm is left out" in note and said in note for note in notes), notes


def test_a_cut_map_is_said(tmp_path):
    cut = textured.png(shiny.bumps())[:-60]
    piece, notes = of_mtl(tmp_path, "Pr 0.5", "norm n.png", images=[("n.png", cut)])
    assert piece.finish.images == ()
    assert any("cannot be decoded" in note for note in notes)


def test_normals_are_told_from_heights():
    assert is_normal_map(shiny.bumps())
    assert is_normal_map(Image.new("RGB", (4, 4), (128, 128, 255)))
    for value in (0, 128, 190, 255):
        assert not is_normal_map(Image.new("L", (4, 4), value))


def test_sdf_brings_its_finish(tmp_path):
    shiny.write_obj(tmp_path, images=[("slab.png", textured.picture()), ("n.png", shiny.bumps())])
    pbr = (
        "<pbr><metal><albedo_map>slab.png</albedo_map><normal_map>n.png</normal_map>"
        "<roughness>0.1</roughness><metalness>1</metalness></metal></pbr>"
    )
    (tmp_path / "slab.sdf").write_text(
        '<sdf version="1.9"><model name="slab"><link name="l"><visual name="v"><geometry><mesh>'
        f"<uri>slab.obj</uri></mesh></geometry><material>{pbr}</material></visual></link></model></sdf>"
    )
    piece, _ = read(tmp_path / "slab.sdf")
    assert numbers(piece) == (0.1, 1.0)
    assert piece.finish.normal == Texture.of(shiny.bumps())


def test_mjcf_brings_its_finish(tmp_path):
    textured.write_obj(tmp_path)
    (tmp_path / "n.png").write_bytes(textured.png(shiny.bumps()))
    (tmp_path / "slab.xml").write_text(
        '<mujoco><asset><mesh name="m" file="slab.obj"/><texture name="n" type="2d" file="n.png"/>'
        '<material name="a" rgba="1 0 0 1" roughness="0.1" metallic="1"><layer role="normal" texture="n"/>'
        '</material><material name="b" roughness="7"/></asset><worldbody><body name="slab"><freejoint/>'
        '<geom type="mesh" mesh="m" material="a"/>'
        '<geom type="sphere" size="0.01" material="b"/></body></worldbody></mujoco>'
    )
    (shape,) = read_source(tmp_path / "slab.xml")
    slab, ball = shape.pieces
    assert numbers(slab) == (0.1, 1.0)
    assert slab.finish.normal == Texture.of(shiny.bumps())
    textured.assert_upright(
        replace(slab, texture=Texture.of(textured.picture()), rgba=(1.0, 1.0, 1.0, 1.0))
    )
    assert (ball.finish.roughness, ball.uv) == (1.0, None)
    assert any("clipped" in note for note in shape.notes)


@pytest.mark.parametrize("value", ['"x"', "[1]", "{}", "null", "3"])
@pytest.mark.parametrize("key", ["normalTexture", "extensions"])
def test_a_strange_material_of_gltf_is_read_or_refused_in_words(tmp_path, key, value):
    path = shiny.write_glb(tmp_path / "slab.glb", {key: json.loads(value)})
    with suppress(ClutterGenError):
        (piece,) = read_mesh_file(path).pieces
        assert piece.finish is None
