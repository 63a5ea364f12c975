"""glTF: numbers that are quantised, sparse or compressed, morphs, skins and copies, and what is refused."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import ReadOptions, read_source
from cluttergen_jax.importing.readers.gltf import read_document
from cluttergen_jax.importing.readers.mesh_file import read_mesh_file
from tests.helpers.cases import CASES
from tests.helpers.gltf import POINTS, Gltf


def corners(path):
    """The file's vertices, in its own frame, sorted."""
    mesh = join_meshes([piece.mesh for piece in read_mesh_file(path).pieces])
    return np.unique(mesh.vertices.round(5) + 0.0, axis=0)


def notes(path):
    return read_mesh_file(path).notes


def sorted_rows(points):
    return np.unique(np.asarray(points, np.float64).round(5) + 0.0, axis=0)


@pytest.mark.parametrize("name", ["draco.glb", "quant_norm.glb"])
def test_compressed_boxes_have_their_size(name):
    (shape,) = read_source(CASES / "08_glb_compressed" / name)
    whole = join_meshes([piece.mesh for piece in shape.pieces])
    np.testing.assert_allclose(np.ptp(whole.bounds, axis=0), [0.1, 0.06, 0.04], atol=1e-4)


def test_meshopt_is_refused_with_what_undoes_it():
    with pytest.raises(
        AssetError, match=r"EXT_meshopt_compression.*gltf-transform copy meshopt\.glb"
    ):
        read_source(CASES / "08_glb_compressed" / "meshopt.glb")


@pytest.mark.parametrize("file", ["box.glb", "box.gltf", "inline.gltf"])
@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16"])
def test_normalised_integers_are_divided(tmp_path, file, dtype):
    gltf = Gltf()
    most = np.iinfo(dtype).max
    steps = np.round((POINTS / 0.1 + (0.5 if dtype[0] == "u" else 0)) * most).astype(dtype)
    gltf.primitive["attributes"]["POSITION"] = gltf.add(steps, normalized=True)
    gltf.document["nodes"][0]["scale"] = [0.1, 0.1, 0.1]
    gltf.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    size = np.ptp(corners(gltf.write(tmp_path / file)), axis=0)
    np.testing.assert_allclose(size, [0.1, 0.06, 0.04], atol=0.1 / most)


@pytest.mark.parametrize("is_quantised", [False, True])
def test_a_file_without_a_scene_is_all_its_roots(tmp_path, is_quantised):
    gltf = Gltf()
    del gltf.document["scene"], gltf.document["scenes"]
    if is_quantised:
        steps = np.round(POINTS / 0.1 * 127).astype(np.int8)
        gltf.primitive["attributes"]["POSITION"] = gltf.add(steps, normalized=True)
    gltf.document["nodes"] = [{"children": [1], "scale": [0.5] * 3}, {"mesh": 0}]
    size = [0.5, 0.3, 0.2] if is_quantised else [0.05, 0.03, 0.02]
    np.testing.assert_allclose(
        np.ptp(corners(gltf.write(tmp_path / "box.glb")), axis=0), size, atol=0.01 * size[0]
    )


def test_nodes_in_a_circle_are_refused(tmp_path):
    gltf = Gltf()
    gltf.document["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [0]}]
    with pytest.raises(AssetError, match=r"box\.glb: nodes 1, 0 hang on each other in a circle"):
        read_mesh_file(gltf.write(tmp_path / "box.glb"))


def test_sparse_vertices_are_where_they_are_moved(tmp_path):
    gltf = Gltf()
    places = np.array([[0], [7]], np.uint8)
    moved = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    sparse = {"count": 2, "indices": {"bufferView": gltf.view(places), "componentType": 5121}}
    sparse["values"] = {"bufferView": gltf.view(moved)}
    gltf.document["accessors"][gltf.primitive["attributes"]["POSITION"]]["sparse"] = sparse
    expected = POINTS.copy()
    expected[[0, 7]] = moved
    np.testing.assert_allclose(corners(gltf.write(tmp_path / "box.glb")), sorted_rows(expected))


@pytest.mark.parametrize("owner", ["nodes", "meshes"])
def test_morph_weights_are_applied(tmp_path, owner):
    gltf = Gltf()
    push = np.tile(np.array([[0, 0, 0.02]], np.float32), (8, 1))
    gltf.primitive["targets"] = [{"POSITION": gltf.add(push)}, {"POSITION": gltf.add(-9 * push)}]
    np.testing.assert_allclose(corners(gltf.write(tmp_path / "rest.glb")), sorted_rows(POINTS))
    gltf.document[owner][0]["weights"] = [0.5, 0]
    path = gltf.write(tmp_path / "box.glb")
    np.testing.assert_allclose(corners(path), sorted_rows(np.add(POINTS, [0, 0, 0.01])))
    assert "weights" in notes(path)[0]


def test_a_skin_is_placed_by_its_joints(tmp_path):
    gltf = Gltf()
    count = len(POINTS)
    upper = POINTS[:, 2] > 0
    joints = np.zeros((count, 4), np.uint8)
    joints[upper, 0] = 1
    share = np.tile(np.array([[255, 0, 0, 0]], np.uint8), (count, 1))
    gltf.primitive["attributes"] |= {
        "JOINTS_0": gltf.add(joints),
        "WEIGHTS_0": gltf.add(share, normalized=True),
    }
    inverse = np.array([np.eye(4), np.eye(4)], np.float32)
    inverse[1, 2, 3] = -0.02
    stored = inverse.transpose(0, 2, 1).reshape(2, 16)
    gltf.document["skins"] = [
        {"joints": [1, 2], "inverseBindMatrices": gltf.add(np.ascontiguousarray(stored))}
    ]
    # What the skinned node is moved by counts for nothing: the joints place the surface.
    gltf.document["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [7, 7, 7]},
        {"translation": [1, 0, 0], "children": [2]},
        {"translation": [0, 0, 0.05]},
    ]
    gltf.document["scenes"] = [{"nodes": [0, 1]}]
    path = gltf.write(tmp_path / "box.glb")
    lifted = np.add(POINTS, [1, 0, 0]) + np.outer(upper, [0, 0, 0.03])
    np.testing.assert_allclose(corners(path), sorted_rows(lifted), atol=1e-5)
    assert "skin" in notes(path)[0]


def test_every_copy_of_an_instanced_mesh_is_read(tmp_path):
    gltf = Gltf()
    places = np.array([[0, 0, 0], [0.5, 0, 0]], np.float32)
    sizes = np.array([[1, 1, 1], [2, 2, 2]], np.float32)
    attributes = {"TRANSLATION": gltf.add(places), "SCALE": gltf.add(sizes)}
    gltf.document["nodes"][0] |= {"translation": [0, 0, 1]}
    gltf.document["nodes"][0]["extensions"] = {
        "EXT_mesh_gpu_instancing": {"attributes": attributes}
    }
    gltf.document["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    path = gltf.write(tmp_path / "box.glb")
    assert len(read_mesh_file(path).pieces) == 2
    both = np.add(np.concatenate([POINTS, np.add(2 * POINTS, [0.5, 0, 0])]), [0, 0, 1])
    np.testing.assert_allclose(corners(path), sorted_rows(both))


@pytest.mark.parametrize(
    "name", ["VND_curved_patches", "EXT_meshopt_compression", "KHR_meshopt_compression"]
)
def test_an_extension_that_is_required_and_not_understood_is_refused(tmp_path, name):
    gltf = Gltf()
    gltf.document |= {"extensionsUsed": [name], "extensionsRequired": [name]}
    with pytest.raises(AssetError, match=f"{name}, which is not read.*Try"):
        read_source(gltf.write(tmp_path / "box.glb"))


def test_draco_without_its_library_is_told(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "DracoPy", None)
    with pytest.raises(
        AssetError, match=r"draco\.glb with KHR_draco_mesh_compression.*pip install DracoPy"
    ):
        read_source(CASES / "08_glb_compressed" / "draco.glb", ReadOptions())


def painted(path, size=8):
    """A box with a red image, as trimesh writes it: its material has no name."""
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    look = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.new("RGB", (size, size), (255, 0, 0))
    )
    box.visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), material=look)
    box.export(path)
    return path


def test_a_material_needs_no_name(tmp_path):
    path = painted(tmp_path / "red.glb")
    assert "name" not in read_document(path)["materials"][0]
    (piece,), notes, _ = read_mesh_file(path)
    assert piece.texture is not None
    assert not notes
    document = read_document(path)
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    data = bytearray(path.read_bytes())
    start = len(data) - document["buffers"][0]["byteLength"] + view.get("byteOffset", 0)
    data[start : start + view["byteLength"]] = bytes(view["byteLength"])
    path.write_bytes(data)
    (piece,), notes, _ = read_mesh_file(path)
    assert piece.texture is None
    assert notes == ("the image of material 'number 0' cannot be read",)


GLOSSY = {"diffuseFactor": [1, 0, 0, 1], "specularFactor": [0, 0, 0], "glossinessFactor": 0.5}
LEFT_OUT = ("its vertex colours are left out: the colour or the image of its material is taken",)


@pytest.mark.parametrize(
    ("material", "rgba", "said"),
    [
        ({}, (0, 128, 0, 255), ()),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]}}, (0, 128, 0, 255), ()),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 0]}}, (255, 0, 0, 255), LEFT_OUT),
        (
            {"extensions": {"KHR_materials_pbrSpecularGlossiness": GLOSSY}},
            (255, 0, 0, 255),
            LEFT_OUT,
        ),
        (
            {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 0.4]}, "alphaMode": "BLEND"},
            (255, 0, 0, 102),
            LEFT_OUT,
        ),
    ],
)
def test_colours_at_vertices_show_under_a_white_material_and_alpha_where_it_is_meant(
    tmp_path, material, rgba, said
):
    gltf = Gltf()
    green = np.tile(np.array([[0, 128, 0, 255]], np.uint8), (len(POINTS), 1))
    gltf.primitive["attributes"]["COLOR_0"] = gltf.add(green, normalized=True)
    gltf.document["materials"] = [material]
    gltf.primitive["material"] = 0
    (piece,), notes, _ = read_mesh_file(gltf.write(tmp_path / "box.glb"))
    np.testing.assert_allclose(np.array(piece.rgba) * 255, rgba, atol=1)
    assert notes == said
