"""Finishes in every export, read back by a program or by the rules of the format."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.shape import Texture
from cluttergen_jax.rendering.viewer.scene_nodes import dressed_mesh
from cluttergen_jax.scene.export.formats import find_format
from tests.helpers import shiny, textured

ORM = Texture.of(shiny.gloss(0.5, 0.8))
GLASS = (0.8, 0.9, 1.0, 0.3)


@pytest.fixture(scope="module")
def scene():
    """A slab of brass with three images, one of glass without, and one of which nothing is known."""
    brass = shiny.asset("brass", orm=ORM)
    glass = shiny.asset(
        "glass", has_image=False, normal=None, roughness=0.0, metallic=0.0, transmission=1.0
    )
    glass = replace(glass, pieces=(replace(glass.pieces[0], rgba=GLASS),))
    return textured.scene(brass, glass, textured.asset("plain"))


def test_mjcf(folder_of):
    model = mujoco.MjModel.from_xml_path(str(folder_of("mjcf") / "scenes" / "000000.xml"))
    found = {}
    for geom in np.flatnonzero(model.geom_matid >= 0).tolist():
        body = model.body(int(model.geom_bodyid[geom])).name
        found[body] = int(model.geom_matid[geom])
    numbers = {name: (model.mat_roughness[k], model.mat_metallic[k]) for name, k in found.items()}
    assert numbers["brass"] == pytest.approx((0.1, 1.0))
    assert numbers["glass"] == pytest.approx((0.0, 0.0))
    assert numbers["plain"] == (-1, -1)
    images = {
        role: model.texture(int(index)).name
        for role, index in enumerate(model.mat_texid[found["brass"]])
        if index >= 0
    }
    roles = mujoco.mjtTextureRole
    assert images[roles.mjTEXROLE_NORMAL] == shiny.FINISH.normal.file_name.removesuffix(".png")
    assert images[roles.mjTEXROLE_ORM] == ORM.file_name.removesuffix(".png")
    assert roles.mjTEXROLE_RGB in images
    assert model.mat_rgba[found["glass"]][3] == pytest.approx(0.3)


def test_old_mjcf_says_nothing_that_old_readers_do_not_know(folder_of):
    path = folder_of(find_format("mjcf", old_mujoco=True)) / "scenes" / "000000.xml"
    text = path.read_text()
    assert not any(word in text for word in ("roughness", "metallic", "<layer"))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.mat_specular.max() > 0.25


def test_gltf(folder_of):
    path = folder_of("glb") / "scenes" / "000000.glb"
    document = shiny.document_of(path)
    materials = {}
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            materials[mesh["name"]] = document["materials"][primitive["material"]]
    brass = materials["brass"]
    look = brass["pbrMetallicRoughness"]
    assert (look["roughnessFactor"], look["metallicFactor"]) == (0.1, 1.0)
    for texture, image in (
        (look["baseColorTexture"], textured.picture()),
        (look["metallicRoughnessTexture"], ORM.image),
        (brass["normalTexture"], shiny.bumps()),
    ):
        shown = shiny.pixels_of(document, path, texture["index"])
        np.testing.assert_array_equal(shown, np.asarray(image))
    glass = materials["glass"]
    assert glass["alphaMode"] == "BLEND"
    assert glass["pbrMetallicRoughness"]["baseColorFactor"][3] == pytest.approx(0.3)
    assert glass["extensions"] == {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    assert document["extensionsUsed"] == ["KHR_materials_transmission"]
    plain = materials["plain"]["pbrMetallicRoughness"]
    assert (plain["roughnessFactor"], plain["metallicFactor"]) == (0.65, 0.0)
    read = trimesh.load_scene(str(path), process=False).geometry["brass"].visual.material
    assert (read.roughnessFactor, read.metallicFactor) == (0.1, 1.0)
    np.testing.assert_array_equal(np.asarray(read.normalTexture), np.asarray(shiny.bumps()))


def test_usd(folder_of):
    pytest.importorskip("pxr", reason="needs the extra usd")
    from pxr import Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(folder_of("usd") / "scenes" / "000000.usda"))

    def shader_of(name):
        prims = Usd.PrimRange(stage.GetPrimAtPath(f"/World/objects/{name}"))
        (mesh,) = (
            each for each in prims if each.IsA(UsdGeom.Mesh) and "visuals" in str(each.GetPath())
        )
        material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
        return material.ComputeSurfaceSource()[0]

    def image_of(shader, name):
        source, channel, _ = shader.GetInput(name).GetConnectedSource()
        return UsdShade.Shader(source.GetPrim()), channel

    def value(shader, name):
        return shader.GetInput(name).Get()

    brass = shader_of("brass")
    for name, channel, place in (("roughness", "g", 1), ("metallic", "b", 2)):
        image, found = image_of(brass, name)
        assert found == channel
        assert value(image, "sourceColorSpace") == "raw"
        factor = {"roughness": 0.1, "metallic": 1.0}[name]
        assert value(image, "scale")[place] == pytest.approx(factor)
        with open(value(image, "file").resolvedPath, "rb") as file:
            assert file.read() == ORM.data
    image, _ = image_of(brass, "normal")
    assert tuple(value(image, "scale"))[:3] == (2, 2, 2)
    assert tuple(value(image, "bias"))[:3] == (-1, -1, -1)
    with open(value(image, "file").resolvedPath, "rb") as file:
        assert file.read() == shiny.FINISH.normal.data
    colours, _ = image_of(brass, "diffuseColor")
    assert value(colours, "sourceColorSpace") == "sRGB"
    glass = shader_of("glass")
    assert (value(glass, "roughness"), value(glass, "metallic")) == (0, 0)
    assert value(glass, "opacity") == pytest.approx(0.3)
    plain = shader_of("plain")
    assert value(plain, "roughness") == pytest.approx(0.65)


@pytest.mark.parametrize("format", ["urdf", "sdf", "maniskill"])
def test_materials_of_meshes(folder_of, format):
    """MTL has no map of roughness and metalness in one: it says the means."""
    (library,) = folder_of(format).rglob("objects/brass/*.mtl")
    lines = dict(line.split(" ", 1) for line in library.read_text().splitlines())
    assert float(lines["Pr"]) == pytest.approx(0.05, abs=1e-3)
    assert float(lines["Pm"]) == pytest.approx(0.8, abs=1e-2)
    assert (library.parent / lines["norm"]).read_bytes() == shiny.FINISH.normal.data
    assert float(lines["Ns"]) > 100
    (library,) = folder_of(format).rglob("objects/glass/*.mtl")
    lines = dict(line.split(" ", 1) for line in library.read_text().splitlines())
    assert "map_Kd" not in lines
    assert float(lines["d"]) == pytest.approx(0.3)
    (library,) = folder_of(format).rglob("objects/plain/*.mtl")
    assert "Ks 0 0 0" in library.read_text()
    assert "Pr" not in library.read_text()


def test_sdf(folder_of):
    root = ET.parse(folder_of("sdf") / "assets" / "objects" / "glass" / "glass.sdf").getroot()
    (metal,) = root.iter("metal")
    assert float(metal.findtext("roughness")) == 0
    assert float(metal.findtext("metalness")) == 0


def test_maniskill(folder_of):
    record = json.loads((folder_of("maniskill") / "scenes" / "000000.json").read_text())
    (visual,) = record["assets"]["brass"]["visuals"]
    assert visual["finish"]["roughness"] == pytest.approx(0.05, abs=1e-3)
    folder = folder_of("maniskill") / record["assets"]["brass"]["folder"]
    assert (folder / visual["finish"]["normal"]).is_file()
    (visual,) = record["assets"]["glass"]["visuals"]
    assert visual["finish"]["transmission"] == 1
    (visual,) = record["assets"]["plain"]["visuals"]
    assert "finish" not in visual


def test_robosuite(folder_of):
    folder = folder_of("robosuite") / "assets" / "objects"
    model = mujoco.MjModel.from_xml_path(str(folder / "brass" / "brass.xml"))
    assert model.mat_roughness == pytest.approx([0.05], abs=1e-3)
    # It renames textures, but none of layers.
    assert "<layer" not in (folder / "brass" / "brass.xml").read_text()
    model = mujoco.MjModel.from_xml_path(str(folder / "glass" / "glass.xml"))
    assert model.mat_metallic == pytest.approx([0])


def test_the_viewer(scene):
    brass, glass = (dressed_mesh(asset.pieces[0]).visual.material for asset in scene.objects[:2])
    assert (brass.roughnessFactor, brass.metallicFactor) == (0.1, 1.0)
    np.testing.assert_array_equal(np.asarray(brass.normalTexture), np.asarray(shiny.bumps()))
    assert (glass.roughnessFactor, glass.alphaMode) == (0.0, "BLEND")
    plain = dressed_mesh(scene.objects[2].pieces[0]).visual.material
    assert plain.roughnessFactor == Finish().roughness
