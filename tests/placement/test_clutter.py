"""Clutter targets: parsing, the draw against scipy, features against what placing changes, real scenes."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from shapely import affinity
from shapely.geometry import box as rectangle

from cluttergen_jax.learning.methods import Method, sampler_of
from cluttergen_jax.placement.boxes import Boxes, Views, gaps, hidden_shares, spacing_of
from cluttergen_jax.placement.candidate_sampler import shortfall, tilt_logits
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.features import FEATURES, Placing
from cluttergen_jax.placement.problem import ProblemConfig, make_setup
from cluttergen_jax.placement.rollout import Rollout
from cluttergen_jax.scene.bank.table import table_of
from tests.helpers.problems import trio_problem

NEAR_ENOUGH = 2e-3


@pytest.mark.parametrize(
    ("asked", "far"),
    [([1.0, 0.5], [0.0, 0.0]), ([4.0, 0.5], [1.0, 0.0]), ([-1.0, 0.9], [1.0, 0.3])],
)
def test_shortfall_is_the_way_to_the_nearest_value(asked, far):
    values = jnp.array([[0.0, 0.2], [3.0, 0.6], [9.0, 9.0]])
    found = shortfall(jnp.array(asked), values, jnp.array([True, True, False]))
    np.testing.assert_allclose(found, far, atol=1e-6)
    assert jnp.isinf(shortfall(jnp.array(asked), values, jnp.zeros(3, bool))).all()


def drawn(seed: int, number: int = 40, features: int = 3):
    draw = np.random.default_rng(seed)
    values = draw.normal(size=(number, features)) * [1.0, 0.02, 5.0]
    return draw.normal(size=number), values, draw.uniform(size=number) < 0.6


@pytest.mark.parametrize("seed", range(4))
def test_tilted_weights_are_those_of_maximum_entropy(seed):
    logits, values, is_allowed = drawn(seed)
    asked = (
        np.random.default_rng(seed + 10).dirichlet(np.ones(is_allowed.sum())) @ values[is_allowed]
    )
    found = jax.nn.softmax(
        jnp.where(is_allowed, tilt_logits(logits, values, asked, is_allowed), -jnp.inf)
    )
    base = logits[is_allowed]
    unit = values[is_allowed].std(0)
    scaled = (values[is_allowed] - asked) / unit
    best = minimize(
        lambda slope: np.log(np.exp(base + scaled @ slope).sum()), np.zeros(3), tol=1e-10
    ).x
    exact = np.exp(base + scaled @ best)
    np.testing.assert_allclose(np.asarray(found)[is_allowed], exact / exact.sum(), atol=NEAR_ENOUGH)
    np.testing.assert_allclose((found @ values - asked) / unit, 0, atol=5 * NEAR_ENOUGH)


def some_boxes(seed: int, number: int = 6) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    half = draw.uniform(0.01, 0.08, (number, 3))
    yaw = draw.uniform(0, 2 * np.pi, number)
    turn = Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True)
    return half, np.c_[draw.uniform(-0.2, 0.2, (number, 3)), turn]


def test_gaps_are_the_distances_of_rectangles():
    half, poses = some_boxes(0, 12)
    boxes = Boxes.of(jnp.asarray(half), jnp.asarray(poses))
    found = np.asarray(gaps(boxes, boxes))
    np.testing.assert_allclose(found, found.T, atol=1e-6)
    shapes = []
    for (x, y, _), pose in zip(half, poses, strict=True):
        turn = Rotation.from_quat(pose[3:], scalar_first=True).as_euler("xyz", degrees=True)[2]
        shapes.append(affinity.translate(affinity.rotate(rectangle(-x, -y, x, y), turn), *pose[:2]))
    exact = np.array([[one.distance(other) for other in shapes] for one in shapes])
    assert np.all(found <= exact + 1e-6)
    assert np.all(found >= exact / np.sqrt(2) - 1e-6)
    assert np.all((found > 1e-6) == (exact > 1e-6))


def test_a_tall_box_hides_a_low_one_from_one_side():
    half = jnp.array([[0.02, 0.02, 0.02], [0.02, 0.02, 0.2]])
    poses = jnp.array([[0.0, 0, 0.02, 1, 0, 0, 0], [0.1, 0, 0.2, 1, 0, 0, 0]])
    views = Views.of(Boxes.of(half, poses))
    hidden = np.asarray(hidden_shares(views, views))
    assert hidden[0, 1, 0] == pytest.approx(0.6, abs=1e-5)
    assert hidden[0, 1, 4] == 0
    assert hidden[1, 0, 0] == 0


@pytest.mark.parametrize("number", [1, 2, 4])
@pytest.mark.slow
def test_what_is_said_to_be_added_is_what_placing_changes(number):
    problem = trio_problem(num_objects=3)
    rules = problem.rules
    half, poses = some_boxes(3)
    geometry = rules.geometry.replace(half_extents=jnp.asarray(half, jnp.float32))
    episode = rules.begin(jax.random.key(0))
    is_placed = jnp.arange(6) < number
    at = Placing(
        episode.replace(poses=jnp.asarray(poses, jnp.float32), is_placed=is_placed),
        Boxes.of(geometry.half_extents, jnp.asarray(poses)),
        Boxes.of(geometry.half_extents[5:], jnp.asarray(poses[5:])),
        None,
    )
    after = at.replace(episode=at.episode.replace(is_placed=is_placed.at[5].set(True)))
    for name in ("near", "occlusion"):
        change = FEATURES[name].total(after) - FEATURES[name].total(at)
        np.testing.assert_allclose(FEATURES[name].added(at)[0], change, atol=1e-5)
    near, hidden = spacing_of(geometry.half_extents, jnp.asarray(poses), after.episode.is_placed)
    np.testing.assert_allclose(near * (number + 1), FEATURES["near"].total(after), atol=1e-6)
    np.testing.assert_allclose(hidden * (number + 1), FEATURES["occlusion"].total(after), atol=1e-6)


def filled(num_scenes: int, support: str = "table", num_objects: int = 10, **placement):
    placement = PlacementConfig(
        num_objects=num_objects, order="weighted", ruin_after=3, history_stride=0, **placement
    )
    setup = make_setup(ProblemConfig(pool="dining", support=support, placement=placement))
    sampler = sampler_of(setup, Method("spread"))
    return setup, Rollout().run_all(sampler, jax.random.key(0), num_scenes, num_scenes)


@pytest.mark.parametrize("asked", [0, 3])
@pytest.mark.slow
def test_scenes_have_as_many_on_others_as_was_asked(asked):
    setup, scenes = filled(16, clutter={"stack": asked}, min_margin=0.003)
    assert scenes.is_success.mean() > 0.9
    on = (scenes.level > 0).sum(1)[scenes.is_success]
    assert on.mean() == pytest.approx(asked, abs=0.3)
    assert np.all(scenes.num_touching[scenes.is_success] >= on)
    half = np.asarray(setup.problem.rules.geometry.half_extents)
    rows = table_of(np.arange(16), scenes, setup.problem.world.names, half)
    np.testing.assert_array_equal(rows["num_on"], (scenes.level > 0).sum(1))
    for place, row in enumerate(rows.to_pylist()):
        index = scenes.object_index[place]
        is_placed = scenes.is_placed[place]
        near, hidden = spacing_of(half[index], scenes.poses[place], is_placed)
        assert (row["near"], row["occlusion"]) == pytest.approx(
            (float(near), float(hidden)), abs=1e-5
        )
        assert row["levels"] == scenes.level[place].tolist()


@pytest.mark.slow
def test_nothing_placed_reaches_beyond_the_edge():
    setup, scenes = filled(32, "table-0.40x0.50", overhang="none")
    assert scenes.is_success.mean() > 0.8
    half = np.array([0.2, 0.25])
    objects = setup.problem.world.objects
    for index, poses, is_placed in zip(
        scenes.object_index, scenes.poses, scenes.is_placed, strict=True
    ):
        for k, pose in zip(index[is_placed], poses[is_placed], strict=True):
            turn = Rotation.from_quat(pose[3:], scalar_first=True)
            for part in objects[k].parts:
                beyond = np.abs(turn.apply(part.vertices)[:, :2] + pose[:2]) - half
                assert beyond.max() < 0.002
