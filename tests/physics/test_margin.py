"""Support margins: against shapely and hand arithmetic, as a verdict, in a certificate, and in records."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapely.geometry import MultiPoint, Point

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig, stability_record
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.judging.scene_models import SceneModels, TiltConfig, tilt
from cluttergen_jax.physics.margin import OverlapProbe, held_margin, support_margin
from cluttergen_jax.physics.mjx import support_margins
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.types import Start
from cluttergen_jax.placement.world import make_world
from cluttergen_jax.types import Verdict
from tests.helpers.problems import HalfTable, made_up_rules, try_action
from tests.helpers.worlds import TOP, box

GOOD = jnp.array([0.9, 0.5, 0.5, 0.2])
EDGE = 0.3


def signed_distance(points):
    """From the origin to the edge of the convex hull, positive within, as shapely has it."""
    hull = MultiPoint(points).convex_hull
    origin = Point(0, 0)
    is_within = hull.geom_type == "Polygon" and hull.contains(origin)
    return hull.exterior.distance(origin) if is_within else -hull.distance(origin)


def some_points(number):
    """Sets of points around, beside and on the origin, some of them on one line."""
    draw = np.random.default_rng(0)
    for turn in range(number):
        points = draw.normal(size=(draw.integers(1, 20), 2)) * 0.05 + draw.normal(
            size=2
        ) * draw.uniform(0, 0.1)
        points[:, 1] = points[0, 1] if turn % 5 == 0 else points[:, 1]
        yield points * (turn % 17 != 0)


def test_the_margin_is_the_signed_distance_to_the_hull():
    for points in some_points(500):
        assert support_margin(points) == pytest.approx(signed_distance(points), abs=1e-12)
    assert support_margin(np.zeros((0, 2))) == -math.inf


def test_a_batch_in_jax_is_each_by_itself():
    sets = [*some_points(40), np.zeros((0, 2))]
    center = np.random.default_rng(1).normal(size=(len(sets), 2))
    body = np.concatenate(
        [np.repeat(np.arange(len(sets)), [len(points) for points in sets]), [len(sets)] * 9]
    )
    position = np.concatenate(
        [points + at for points, at in zip(sets, center, strict=True)] + [np.ones((9, 2))]
    )
    order = np.random.default_rng(2).permutation(len(body))
    found = jax.jit(support_margins)(
        jnp.asarray(position[order], jnp.float32),
        jnp.asarray(body[order]),
        jnp.asarray(center, jnp.float32),
    )
    np.testing.assert_allclose(found, [support_margin(points) for points in sets], atol=1e-6)


@dataclasses.dataclass(frozen=True)
class Margins(HalfTable):
    """What comes to rest has these margins, object by object."""

    margin: tuple[float, ...] = (0.02,) * 6

    def settle(self, poses, is_placed, focus, is_active):
        return (
            super()
            .settle(poses, is_placed, focus, is_active)
            .replace(margin=jnp.array(self.margin))
        )


def attempt(margin, **placement):
    """The episode after one good attempt at the first object of six; margins that are not given are 2 cm."""
    physics = Margins(margin=tuple(margin.get(k, 0.02) for k in range(6)))
    rules = made_up_rules(physics=physics, order="fixed", **placement)
    return try_action(rules, rules.begin(jax.random.key(0)), GOOD)[0]


def test_too_small_a_margin_is_a_verdict_of_its_own():
    after = attempt({0: 0.0029}, min_margin=0.003)
    assert int(after.verdict) == Verdict.UNSUPPORTED
    assert (int(after.slot), int(after.attempt)) == (0, 1)
    assert int(after.counts.verdicts[Verdict.UNSUPPORTED]) == 1 == int(after.counts.verdicts.sum())
    assert int(attempt({0: 0.0031}, min_margin=0.003).slot) == 1
    # Others that the attempt took support from, but not those that were never placed.
    assert int(attempt({3: -0.1}, min_margin=0.003).slot) == 1


def test_a_neighbour_that_lost_its_support_counts_unless_it_stood_there_before():
    rules = made_up_rules(
        physics=Margins(margin=(0.02, 0.001, 0.02, 0.02, 0.02, 0.02)), order="fixed"
    )
    rules = dataclasses.replace(
        rules, config=dataclasses.replace(rules.config, min_margin=0.003), num_started=1
    )
    poses = jnp.zeros((6, 7)).at[:, 3].set(1.0)
    around = rules.begin(jax.random.key(0), start=Start(poses, jnp.arange(6) == 1))
    assert int(try_action(rules, around, GOOD)[0].verdict) == Verdict.STABLE
    own = dataclasses.replace(around, first_slot=jnp.int32(0))
    assert int(try_action(rules, own, GOOD)[0].verdict) == Verdict.UNSUPPORTED


def test_a_narrow_object_is_asked_for_a_third_of_its_own():
    rules = made_up_rules(physics=Margins(margin=(0.0006,) * 6), min_margin=0.003)
    for own, verdict in ((0.001, Verdict.STABLE), (0.002, Verdict.UNSUPPORTED)):
        geometry = rules.geometry.replace(own_margin=jnp.full(6, own))
        narrow = dataclasses.replace(rules, geometry=geometry)
        episode = narrow.begin(jax.random.key(0))
        assert int(try_action(narrow, episode, GOOD)[0].verdict) == verdict


@pytest.fixture(scope="module")
def models():
    objects = [box("cube", (0.03, 0.03, 0.03)), box("tall", (0.02, 0.04, 0.1))]
    return SceneModels(make_world(objects, cuboid_table(), StabilityConfig(), ContactConfig()))


@pytest.fixture(scope="module")
def brink():
    """The cube in the middle, and the tall box with its centre of mass 2.8 mm inside the table's edge."""
    poses = np.tile(np.eye(7)[3], (1, 2, 1))
    poses[0, :, :3] = [[0, 0, TOP + 0.03], [EDGE - 0.0028, 0, TOP + 0.1]]
    return poses, np.ones((1, 2), bool)


def test_tilted_gravity_topples_what_hand_arithmetic_says(models, brink):
    # At height h, gravity tilted by a moves the load by h tan(a): 1.7, 3.5 and 8.7 mm; 45 degrees off the
    # edge's normal by 0.7 of that.
    np.testing.assert_allclose(tilt(models, *brink, num_threads=1), [[1.0, 7 / 8, 5 / 8]])
    middle = tilt(
        models, brink[0] * [0.5, 1, 1, 1, 1, 1, 1], brink[1], TiltConfig((5.0,)), num_threads=1
    )
    np.testing.assert_allclose(middle, 1.0)
    with pytest.raises(ConfigError, match="ascend"):
        TiltConfig((5.0, 1.0))


def test_a_wall_holds_what_leans_on_it_by_hand_arithmetic():
    # The foot is an edge of 4 cm, 2 cm behind the centre of mass; the wall touches 10 cm above it.
    foot = np.array([[-0.02, -0.02, -0.05], [-0.02, 0.02, -0.05]])
    wall = np.array([[0.02, 0.0, 0.05]])
    against = np.array([[-1.0, 0.0, 0.0]])
    assert support_margin(foot[:, :2]) == pytest.approx(-0.02)
    assert held_margin(foot, wall, against) == pytest.approx(-0.02 + 0.35 * 0.10)
    # One that pulls the other way, or touches at the foot's height, holds nothing.
    assert held_margin(foot, wall, -against) == pytest.approx(-0.02)
    low = wall - [[0.0, 0.0, 0.1]]
    assert held_margin(foot, low, against) == pytest.approx(-0.02)


def test_what_holds_a_side_never_takes_from_a_margin():
    draw = np.random.default_rng(3)
    nothing = np.zeros((0, 3))
    for plan in some_points(100):
        points = np.c_[plan, draw.normal(size=len(plan)) * 0.02]
        normals = draw.normal(size=(4, 3)) * [1.0, 1.0, 0.2]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sides = draw.normal(size=(4, 3)) * 0.05
        assert held_margin(points, nothing, nothing) == support_margin(plan)
        held = held_margin(points, sides, normals)
        assert held >= support_margin(plan)
        # Turned all together about the vertical it is the same, up to the directions that are tried.
        turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
        again = held_margin(points @ turn.T, sides @ turn.T, normals @ turn.T)
        assert again == pytest.approx(held, abs=0.002)
    assert held_margin(nothing, sides, normals) == -math.inf


def leaning_plank(side_support):
    """The margin of a plank that came to rest against a heavy block, and how that attempt ended."""
    objects = [box("block", (0.05, 0.05, 0.08), 5.0), box("plank", (0.005, 0.03, 0.06))]
    config = StabilityConfig(side_support=side_support, settle_steps=220)
    world = make_world(objects, cuboid_table(), config, ContactConfig())
    engine = NativePhysics(world.layout, config, num_threads=1)
    tilt = math.radians(-14.0)
    poses = np.zeros((1, 2, 7), np.float32)
    poses[0, 0] = [0.0, 0.0, TOP + 0.08, 1.0, 0.0, 0.0, 0.0]
    poses[0, 1] = [0.074, 0.0, TOP + 0.0605, math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0]
    everyone = np.ones((1, 2), bool)
    settling = engine.settle_batch(poses, everyone, np.array([1]), np.ones(1, bool))
    return float(settling.margin[0, 1]), Verdict(int(settling.verdict[0]))


def test_a_plank_against_a_block_is_held_where_its_side_counts():
    poor, verdict = leaning_plank(False)
    held, same = leaning_plank(True)
    assert verdict == same == Verdict.STABLE
    assert poor < 0.003 < held


def test_without_contacts_at_sides_nothing_differs():
    config = StabilityConfig()
    world = make_world([box("a", (0.03, 0.02, 0.02))], cuboid_table(), config, ContactConfig())
    pose = np.array([[0.1, 0.1, TOP + 0.0199, math.cos(0.3), 0.0, 0.0, math.sin(0.3)]])
    found = []
    for side_support in (False, True):
        probe = OverlapProbe(world.layout, side_support)
        probe.depths(pose, np.ones(1, bool))
        found.append(probe.margins(np.array([0])))
    assert found[0].tobytes() == found[1].tobytes()
    assert found[0] > 0.01
    assert "side_support" not in stability_record(config)
    assert stability_record(StabilityConfig(side_support=True))["side_support"]
