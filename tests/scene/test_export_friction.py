"""An object's own friction in every format: what a reader makes of two coefficients is what was asked for."""

import json
import math
from dataclasses import replace
from xml.etree import ElementTree as ET

import mujoco
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.scene.export import export_scenes
from cluttergen_jax.scene.export.shapes import factor_of, harmonic_of, mean_of
from tests.helpers.exports import spread
from tests.helpers.worlds import trio

DEFAULT = ContactConfig().friction[0]


@pytest.mark.parametrize("wanted", [0.3, 0.5, 0.8])
def test_other_rules_come_to_what_is_asked_for(wanted):
    share = factor_of(wanted, DEFAULT)
    assert share * math.sqrt(DEFAULT) == pytest.approx(wanted)
    assert (mean_of(wanted, DEFAULT) + DEFAULT) / 2 == pytest.approx(wanted)
    own = harmonic_of(wanted, DEFAULT)
    assert 2 * own * DEFAULT / (own + DEFAULT) == pytest.approx(wanted)


@pytest.fixture(scope="module")
def scene():
    slippery, plain, *_ = trio()
    return spread((replace(slippery, friction=0.1), plain), cuboid_table())


def folder_of(scene, kind, tmp_path):
    return (
        export_scenes([scene], tmp_path / f"in_{kind}", kind),
        scene.objects[0].name,
        scene.objects[1].name,
    )


def test_urdf(scene, tmp_path):
    folder, own, other = folder_of(scene, "urdf", tmp_path)
    read = [
        float(ET.parse(next(folder.rglob(f"{name}.urdf"))).find(".//lateral_friction").get("value"))
        for name in (own, other)
    ]
    assert read[0] * read[1] == pytest.approx(0.1, rel=1e-5)
    assert read[1] ** 2 == pytest.approx(DEFAULT, rel=1e-5)


def test_sdf(scene, tmp_path):
    folder, _, _ = folder_of(scene, "sdf", tmp_path)
    root = ET.parse(next((folder / "scenes").glob("*.sdf")))
    read = {model.get("name"): model.find(".//ode/mu").text for model in root.iter("model")}
    assert float(read[scene.names[0]]) == 0.1
    assert float(read[scene.names[1]]) == DEFAULT
    drake = {
        model.get("name"): model.find(".//{http://drake.mit.edu}mu_static")
        for model in root.iter("model")
    }
    assert float(drake[scene.names[0]].text) == pytest.approx(harmonic_of(0.1, DEFAULT), rel=1e-6)
    assert drake[scene.names[1]] is None


def test_robosuite(scene, tmp_path):
    folder, own, other = folder_of(scene, "robosuite", tmp_path)
    models = [
        mujoco.MjModel.from_xml_path(str(next(folder.rglob(f"{name}.xml"))))
        for name in (own, other)
    ]
    solid = [model.geom_contype > 0 for model in models]
    assert models[0].geom_friction[solid[0], 0] == pytest.approx(0.1)
    assert (models[0].geom_priority[solid[0]] > 0).all()
    assert (models[1].geom_priority[solid[1]] == 0).all()


def test_maniskill(scene, tmp_path):
    folder, own, other = folder_of(scene, "maniskill", tmp_path)
    assets = json.loads(next((folder / "scenes").glob("*.json")).read_text())["assets"]
    assert assets[own]["friction"] == 0.0
    assert "friction" not in assets[other]


def test_usd(scene, tmp_path):
    Usd = pytest.importorskip("pxr.Usd", reason="needs the extra usd")
    folder, own, other = folder_of(scene, "usd", tmp_path)
    modes = []
    for name in (own, other):
        stage = Usd.Stage.Open(str(next(folder.rglob(f"{name}.usda"))))
        (material,) = (
            prim for prim in stage.Traverse() if prim.GetAttribute("physics:staticFriction")
        )
        modes.append(material.GetAttribute("physxMaterial:frictionCombineMode").Get())
    assert modes == ["min", None]
