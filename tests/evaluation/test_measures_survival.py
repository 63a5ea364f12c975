"""Scenes in other engines: what stands there stands, what cannot does not."""

from dataclasses import replace

import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.measures.bullet_world import BodyFrames
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.simulate import movement, shift_and_turn, without_sinking
from cluttergen_jax.evaluation.measures.survival import MOST_SINKING, DrakePeer, movement_elsewhere
from cluttergen_jax.placement.world import make_world
from tests.helpers.worlds import TOP, box, convex, prism, tilted

OBJECTS = [box("low", (0.05, 0.05, 0.02)), box("tall", (0.02, 0.03, 0.06)), prism("prism", 0.03, 0.02)]


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


def test_an_object_slides_by_its_own_friction_in_pybullet():
    pytest.importorskip("pybullet", reason="needs the extra peers")
    # On a slope of 15 degrees: steeper than the angle of friction of 0.1, not than that of 0.5.
    slope, half, low = np.radians(15), 0.15, 0.03
    high = low + 2 * half * np.tan(slope)
    middle = (low + high) / 2
    sides = [(-half, low), (half, high), (-half, 0.0), (half, 0.0)]
    corners = np.array([(x, y, z - middle / 2) for x, z in sides for y in (-0.1, 0.1)])
    wedge, stone = convex("wedge", corners, 0.05 * np.eye(3), 5.0), box("stone", (0.03, 0.03, 0.01))
    poses, is_placed = np.tile(np.eye(7)[3], (1, 2, 1)), np.ones((1, 2), bool)
    poses[0, :, 2] = TOP + middle / 2, TOP + middle + 0.01 / np.cos(slope)
    poses[0, 1, 3:] = tilted((0, -1, 0), 15)
    for friction, stands in ((None, True), (0.1, False), (2.0, True)):
        objects = [wedge, replace(stone, friction=friction)]
        models = SceneModels(make_world(objects, cuboid_table(), StabilityConfig(), ContactConfig()))
        assert movement(models, poses, is_placed, (1.0,), 1).survives()[0, 0] == stands
        assert movement_elsewhere("pybullet", models, poses, is_placed, (1.0,)).survives()[0, 0] == stands


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


def test_what_diverges_in_drake_does_not_stand(models, monkeypatch):
    drake = pytest.importorskip("pydrake.all", reason="needs the extra peers")

    class Diverging(drake.Simulator):
        def AdvanceTo(self, time):
            monkeypatch.setattr(Diverging, "AdvanceTo", lambda *_: pytest.fail("it goes on"))
            raise RuntimeError("SceneGraph encountered a non-finite value")

    monkeypatch.setattr(drake, "Simulator", Diverging)
    poses, is_placed, _ = scenes()
    result = movement_elsewhere("drake", models, poses[:1], is_placed[:1])
    assert np.isinf(result.largest_shift).all()
    assert not result.survives().any()


def test_body_frames_go_there_and_back():
    rng = np.random.default_rng(0)
    frames = BodyFrames.of(OBJECTS)
    poses = rng.normal(size=(3, 7))
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    back = frames.object_poses(range(3), frames.body_poses(range(3), poses))
    np.testing.assert_allclose(back[:, :3], poses[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.abs((back[:, 3:] * poses[:, 3:]).sum(1)), 1)


def test_unknown_engine_is_refused(models):
    poses, is_placed, _ = scenes()
    with pytest.raises(ConfigError, match="pybullet, drake"):
        movement_elsewhere("abacus", models, poses, is_placed)


def test_what_all_objects_sink_together_is_no_motion():
    start = np.tile(np.eye(7)[3], (3, 1)) + np.arange(3)[:, None] * np.eye(7)[2]
    sunk = start - 0.002 * np.eye(7)[2]
    shift, _ = shift_and_turn(without_sinking(sunk, start, MOST_SINKING), start)
    assert shift == pytest.approx(0, abs=1e-12)
    one_more = sunk.copy()
    one_more[2, 2] -= 0.003
    # Beyond the common sinking, in plan, up, and more than heaps sink: all of that counts.
    for moved, expected in (
        (one_more, 0.003),
        (sunk + 0.004 * np.eye(7)[0], 0.004),
        (start + 0.006 * np.eye(7)[2], 0.006),
        (start - 0.7 * np.eye(7)[2], 0.695),
    ):
        shift, _ = shift_and_turn(without_sinking(moved, start, MOST_SINKING), start)
        assert shift.max() == pytest.approx(expected)
