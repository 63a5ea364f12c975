"""Images on surfaces: read from every format, kept by pools and banks, the right way up wherever they go."""

import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Piece, Shape, Texture
from cluttergen_jax.assets.support_file import read_support, support_hash, write_support
from cluttergen_jax.assets.visuals import simplify_pieces
from cluttergen_jax.errors import PoolError
from cluttergen_jax.importing.readers import ReadOptions, read_source
from cluttergen_jax.importing.supports import support_with_notes
from tests.helpers import textured
from tests.helpers.shapes import SOURCE
from tests.helpers.textured import assert_upright

WAYS = {
    "obj": textured.write_obj,
    "glb": textured.write_gltf,
    "gltf": lambda folder: textured.write_gltf(folder, "slab.gltf"),
    "dae": textured.write_dae,
    "urdf": textured.write_urdf,
    "urdf-material": lambda folder: textured.write_urdf(folder, with_own_material=False),
    "mjcf": textured.write_mjcf,
}


@pytest.mark.parametrize("way", WAYS)
def test_every_format_brings_its_image_the_right_way_up(way, tmp_path):
    (shape,) = read_source(WAYS[way](tmp_path / "in"))
    (piece,) = shape.pieces
    assert shape.notes == ()
    assert piece.texture.image.size == (64, 64)
    assert_upright(piece)


def _without_image(folder):
    path = textured.write_obj(folder)
    (folder / "slab.png").unlink()
    return path, "slab.png"


def _without_material_file(folder):
    path = textured.write_obj(folder)
    (folder / "slab.mtl").unlink()
    return path, "slab.mtl"


def _no_image(folder):
    path = textured.write_obj(folder)
    (folder / "slab.png").write_text("this is no picture")
    return path, "slab.png cannot be read as an image"


def _cut_image(folder):
    path = textured.write_obj(folder)
    data = (folder / "slab.png").read_bytes()
    (folder / "slab.png").write_bytes(data[:-60])
    return path, "cannot be decoded"


def _broken_in_glb(folder):
    path = textured.write_gltf(folder)
    path.write_bytes(path.read_bytes().replace(b"\x89PNG", b"XXXX"))
    return path, "the image of material 'printed' cannot be read"


def _moved_in_glb(folder):
    path = textured.write_gltf(folder)
    data = path.read_bytes()
    (length,) = struct.unpack("<I", data[12:16])
    document = json.loads(data[20 : 20 + length])
    image = document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    image["extensions"] = {"KHR_texture_transform": {"offset": [0.5, 0]}}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)
    return path, "KHR_texture_transform"


def _with_relief(folder):
    path = textured.write_obj(folder)
    with (folder / "slab.mtl").open("a") as file:
        file.write("map_Bump relief.png\n")
    return path, "map_bump"


def _missing_in_urdf(folder):
    path = textured.write_urdf(folder, with_own_material=False)
    (folder / "slab.png").unlink()
    return path, "slab.png"


@pytest.mark.parametrize(
    "harm",
    [
        _without_image,
        _without_material_file,
        _no_image,
        _cut_image,
        _broken_in_glb,
        _moved_in_glb,
        _with_relief,
        _missing_in_urdf,
    ],
)
def test_an_image_that_is_lost_is_said(harm, tmp_path):
    path, said = harm(tmp_path / "in")
    (shape,) = read_source(path)
    assert any(said in note for note in shape.notes), shape.notes
    assert (shape.pieces[0].texture is None) == (harm not in (_moved_in_glb, _with_relief))


def test_large_images_are_shrunk_unless_asked(tmp_path):
    path = textured.write_obj(tmp_path)
    textured.picture(1500).save(tmp_path / "slab.png", "JPEG")
    (usual,), (large,), (small,) = (
        read_source(path, options)[0].pieces
        for options in (None, ReadOptions(max_texture=4096), ReadOptions(max_texture=16))
    )
    assert [each.texture.image.size[0] for each in (usual, large, small)] == [1024, 1500, 16]
    for piece in (usual, large):
        for (x, y), colour in textured.quarters():
            np.testing.assert_allclose(textured.colour_at(piece, x, y), colour, atol=12)


def test_supports_keep_their_image(tmp_path):
    vertices, faces, uv = textured.slab()
    piece = Piece(
        Mesh(vertices * 5, faces), (1.0, 1.0, 1.0, 1.0), uv, Texture.of(textured.picture())
    )
    support, _ = support_with_notes(Shape("tray", "tray", (piece,), SOURCE))
    back = read_support(write_support(tmp_path / "tray", support))
    assert support_hash(back) == support_hash(support)
    assert back.pieces[0].texture == piece.texture
    (tmp_path / "tray" / piece.texture.file_name).write_bytes(textured.png(textured.picture(32)))
    with pytest.raises(PoolError, match=piece.texture.file_name):
        read_support(tmp_path / "tray")


def test_welding_keeps_seams_and_simplifying_keeps_the_image():
    ball = trimesh.creation.uv_sphere(radius=0.1, count=(60, 60))
    around = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0]) / (2 * np.pi)
    uv = np.column_stack([np.mod(around, 1), ball.vertices[:, 2] / 0.2 + 0.5])
    corners = ball.vertices[ball.faces].reshape(-1, 3)
    corner_uv = uv[ball.faces].reshape(-1, 2)
    # Triangles over the seam end at one.
    wraps = np.ptp(corner_uv[:, 0].reshape(-1, 3), axis=1) > 0.5
    low = corner_uv[:, 0].reshape(-1, 3) < 0.5
    corner_uv[:, 0] += (wraps[:, None] & low).ravel()
    stripes = Image.fromarray(np.repeat(np.arange(256, dtype=np.uint8)[None], 64, axis=0)).convert(
        "RGB"
    )
    faces = np.arange(len(corners)).reshape(-1, 3)
    piece = Piece(Mesh(corners, faces), (1.0, 1.0, 1.0, 1.0), corner_uv, Texture.of(stripes))
    (small,) = simplify_pieces([piece], max_textured=3000)
    assert len(faces) > 6_500
    assert 2_000 < len(small.mesh.faces) <= 3_000
    assert len(small.mesh.vertices) < 0.6 * len(small.mesh.faces)
    middle = small.mesh.vertices[small.mesh.faces].mean(1)
    shown = small.texture.at(small.uv[small.mesh.faces].mean(1))[:, 0]
    meant = np.mod(np.arctan2(middle[:, 1], middle[:, 0]) / (2 * np.pi), 1)
    off = np.abs(shown - meant)
    # All around, the two sides of the seam included, but for the poles, where a place has every colour.
    is_away = np.linalg.norm(middle[:, :2], axis=1) > 0.02
    assert np.quantile(np.minimum(off, 1 - off)[is_away], 0.99) < 0.02
