"""Exports for programs that bring libraries of objects or scenes of their own, opened by their own loaders.

Each is asked in an interpreter of its own: the one that CLUTTERGEN_NAME_PYTHON names, or one that is made for
the test. `tests/peers` holds what runs there; RoboCasa, which no index has, is stood for by robosuite.
"""

import json
import runpy
import sys
from types import ModuleType

import mujoco
import numpy as np
import pytest

from tests.helpers.environments import ask_peer, peer_python
from tests.helpers.exports import dining_scene, exporter


@pytest.fixture(scope="module")
def scene():
    return dining_scene()


@pytest.fixture(scope="module")
def folder_of(scene, tmp_path_factory):
    return exporter(scene, tmp_path_factory)


def test_robocasa_objects_know_their_box(folder_of, scene):
    folder = folder_of("robocasa")
    record = json.loads((folder / "scenes" / "000000.json").read_text())
    for name, asset in scene.assets.items():
        assert record["assets"][name]["file"] == f"objects/cluttergen/{name}/{name}/model.xml"
        model = mujoco.MjModel.from_xml_path(str(folder / record["assets"][name]["file"]))
        box = model.geom("reg_bbox")
        np.testing.assert_allclose(box.size, asset.half_extents, rtol=1e-6)
        assert (box.contype, box.conaffinity, box.group) == (0, 0, 1)
        assert model.body("object").mass == pytest.approx(asset.mass, rel=1e-6)


def test_robocasa_is_told_of_objects_by_kind(folder_of, monkeypatch):
    kitchen = ModuleType("kitchen_object_utils")
    kitchen.OBJ_CATEGORIES, kitchen.OBJ_GROUPS = {"mug": {"objaverse": None}}, {"mug": ["mug"], "all": []}
    kitchen.ObjCat = lambda name, **properties: {"name": name, **properties}
    package = ModuleType("robocasa.models.objects")
    package.kitchen_object_utils = kitchen
    for name in ("robocasa", "robocasa.models"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "robocasa.models.objects", package)
    module = runpy.run_path(str(folder_of("robocasa") / "cluttergen_robocasa.py"))
    assert module["register"](washable=True) == module["register"](washable=True) == ["fork", "mug", "soup_can"]
    assert kitchen.OBJ_GROUPS["cluttergen"] == ["fork", "mug", "soup_can"]
    assert set(kitchen.OBJ_CATEGORIES["mug"]) == {"objaverse", "cluttergen"}
    kind = kitchen.OBJ_CATEGORIES["mug"]["cluttergen"]
    assert (kind["friction"], kind["washable"]) == ((0.5, 0.005, 0.0001), True)
    assert kind["model_folders"] == [str(folder_of("robocasa") / "objects" / "cluttergen" / "mug")]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_robocasa_objects_load_as_robosuite_objects(folder_of, scene, tmp_path):
    packages = ("robosuite==1.5.2", "mujoco==3.3.7")
    report = ask_peer("robocasa", peer_python("robosuite", tmp_path, *packages), folder_of("robocasa"))
    assert set(report["objects"]) == set(scene.assets)
    for name, asset in scene.assets.items():
        told = report["objects"][name]
        np.testing.assert_allclose(told["size"], asset.half_extents, rtol=1e-5)
        np.testing.assert_allclose(told["twice"], 2 * asset.half_extents, rtol=1e-5)
        assert told["pos"] == [0, 0, 0]
        assert told["bottom"][2] == pytest.approx(-asset.half_extents[2], rel=1e-5)
        assert told["mass"] == pytest.approx(asset.mass, rel=1e-5)
        assert told["num_colliding"] == len(asset.parts)
