"""Scenes in other engines: what stands there stands, what cannot does not."""

from dataclasses import replace

import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.judging.scene_models import SceneModels, movement
from cluttergen_jax.placement.world import make_world
from studies.measures.survival import DrakePeer, movement_elsewhere
from tests.helpers.worlds import TOP, box, prism

OBJECTS = [
    box("low", (0.05, 0.05, 0.02)),
    box("tall", (0.02, 0.03, 0.06)),
    prism("prism", 0.03, 0.02),
]


@pytest.fixture(scope="module")
def models():
    return SceneModels(make_world(OBJECTS, cuboid_table(), StabilityConfig(), ContactConfig()))


def scenes():
    """A tower, side by side, one in the air, one over the table's edge; and which of them stand."""
    heights = np.array([0.02, 0.06, 0.02])
    poses = np.tile(np.eye(7)[3], (4, 3, 1))
    poses[:, :, 2] = TOP + heights
    poses[1:, :, 0] = (-0.15, 0.0, 0.15)
    poses[0, 1:, 2] += (0.04, 0.16)
    poses[2, 1, 2] += 0.02
    poses[3, 0, 0] = -0.32
    is_placed = np.ones((4, 3), bool)
    is_placed[1, 1] = False
    return poses, is_placed, [True, True, False, False]


def check(models, engine):
    poses, is_placed, stands = scenes()
    result = movement_elsewhere(engine, models, poses, is_placed, (0.5, 1.0))
    assert result.survives().tolist() == [[each, each] for each in stands]
    assert movement(models, poses, is_placed, (1.0,), 1).survives()[:, 0].tolist() == stands
    assert (result.largest_shift[:2] < 0.001).all()
    assert result.shift[2, 0, 1] == pytest.approx(0.02, abs=0.003)
    assert (result.shift[2, :, [0, 2]] < 0.001).all()
    assert (result.shift[1, :, 1] == 0).all()
    assert (np.diff(result.shift, axis=1) >= 0).all()
    again = movement_elsewhere(engine, models, poses[::-1], is_placed[::-1], (0.5, 1.0))
    np.testing.assert_array_equal(again.shift[::-1], result.shift)


def test_scenes_in_pybullet(models):
    pytest.importorskip("pybullet", reason="needs the extra peers")
    check(models, "pybullet")


def test_scenes_in_drake(models):
    pytest.importorskip("pydrake", reason="needs the extra peers")
    check(models, "drake")


def test_a_pair_has_the_objects_own_friction_in_drake():
    drake = pytest.importorskip("pydrake.all", reason="needs the extra peers")
    frictions = (None, 0.1, 0.9)
    objects = [replace(box(f"box-{f}", (0.03, 0.03, 0.01)), friction=f) for f in frictions]
    models = SceneModels(make_world(objects, cuboid_table(), StabilityConfig(), ContactConfig()))
    peer = DrakePeer(models)
    plant, graph = drake.AddMultibodyPlantSceneGraph(drake.DiagramBuilder(), 1 / 240)
    peer._add_support(plant)
    bodies = [peer._add_object(plant, k) for k in range(3)]

    def friction_of(body):
        (shape,) = plant.GetCollisionGeometriesForBody(body)
        properties = graph.model_inspector().GetProximityProperties(shape)
        return properties.GetProperty("material", "coulomb_friction")

    support, *each = (friction_of(body) for body in (plant.world_body(), *bodies))
    # Drake's own rule for two bodies.
    pairs = [drake.CalcContactFrictionFromSurfaceProperties(support, one) for one in each]
    np.testing.assert_allclose([pair.static_friction() for pair in pairs], [0.5, 0.1, 0.9])
    peer.close()
