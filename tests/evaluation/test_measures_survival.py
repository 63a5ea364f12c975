"""Scenes in other engines: what stands there stands, what cannot does not."""

import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.measures.bullet_world import BodyFrames
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.simulate import movement
from cluttergen_jax.evaluation.measures.survival import movement_elsewhere
from cluttergen_jax.placement.world import make_world
from tests.helpers.worlds import TOP, box, prism

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
