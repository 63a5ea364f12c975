"""Objects on shelves and slopes: what a search sees there, where objects may go, and where they end."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.api.generate import generate
from cluttergen_jax.assets.support import Rectangle, parse_surfaces
from cluttergen_jax.assets.support_map import VOID, check_region
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.problem import ProblemConfig, compose, region_of
from cluttergen_jax.placement.room import check_surface
from cluttergen_jax.placement.search import FORBIDDEN, Candidates
from cluttergen_jax.scene.bank import read_bank, read_scenes
from cluttergen_jax.sensing.partial import Grid
from cluttergen_jax.spec import SceneSpec
from cluttergen_jax.types import Settling, Verdict
from scenes.furniture import make_support
from tests.helpers.worlds import box, prism

BOOKCASE = make_support("bookcase")
SLOPE = make_support("tilted_board_10")
RULES = PlacementConfig(), ContactConfig(), False


def world(support, objects=None, **placement):
    objects = objects or [box("low", (0.03, 0.03, 0.05)), box("tall", (0.03, 0.03, 0.155))]
    config = ProblemConfig(placement=PlacementConfig(**{"num_objects": len(objects)} | placement))
    return compose(objects, support, config)


@pytest.fixture(scope="module")
def shelf():
    return world(BOOKCASE.on_surface("shelf_2"), order="fixed")


@pytest.mark.slow
def test_a_map_begins_at_a_shelf_and_ends_at_the_board_above(shelf):
    rules = shelf.rules
    search = LowestFit(rules)
    poses = np.tile(np.eye(7)[3], (2, 1)).astype(np.float32)
    poses[0, :3] = 0.1, 0.0, BOOKCASE.surfaces[2].position[2] + 0.05
    # The second stands on the board above, and must not be seen.
    poses[1, :3] = -0.1, 0.0, BOOKCASE.surfaces[1].position[2] + 0.155
    heights = search.mapper(rules.region, jnp.array(poses), jnp.ones(2, bool))
    at = [int(heights.index_of(*each)) for each in ((0.1, 0.0), (-0.1, 0.0), (0.3, 0.1))]
    assert np.asarray(heights.at(jnp.array(at))) == pytest.approx([0.1, 0.0, 0.0], abs=1e-5)
    ceiling = np.asarray(heights.ceiling).reshape(-1)[at]
    assert ceiling == pytest.approx(np.full(3, 0.316), abs=1e-5)
    side = int(heights.index_of(0.391, 0.0))
    assert float(heights.at(side)) > 0.3
    assert float(heights.at(int(heights.index_of(0.0, -0.2)))) == VOID


@pytest.mark.slow
def test_what_does_not_fit_under_a_board_is_forbidden(shelf):
    search = LowestFit(shelf.rules)
    episode = shelf.rules.begin(jax.random.key(0))
    one = Candidates(jnp.zeros((1, 2)), jnp.zeros(1))
    assert float(search.closely(search.scene(episode), one).cost[0]) < FORBIDDEN / 2
    # A tall one stands below the board, but not on anything.
    episode = episode.replace(slot=episode.slot + 1)
    assert float(search.closely(search.scene(episode), one).cost[0]) < FORBIDDEN / 2
    poses = episode.poses.at[0, :3].set(
        jnp.array([0.0, 0.0, BOOKCASE.surfaces[2].position[2] + 0.05])
    )
    episode = episode.replace(poses=poses, is_placed=jnp.array([True, False]))
    assert float(search.closely(search.scene(episode), one).cost[0]) > FORBIDDEN / 2


def settled(rules, position):
    """What physics would tell of an object that rests there."""
    poses = np.tile(np.eye(7)[3], (rules.geometry.num_objects, 1)).astype(np.float32)
    poses[0, :3] = position
    made = jax.eval_shape(
        rules.simulator.settle, poses, np.ones(2, bool), jnp.int32(0), jnp.bool_(True)
    )
    zeros = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), made)
    return Settling(**{**zeros.__dict__, "poses": jnp.array(poses)})


@pytest.mark.slow
def test_an_object_has_to_end_on_its_own_surface(shelf):
    rules = shelf.rules
    (_, above, own, below) = BOOKCASE.surfaces
    episode = rules.begin(jax.random.key(0))
    ends = {
        Verdict.STABLE: own.position[2] + 0.05,
        Verdict.FELL: below.position[2] + 0.05,
        Verdict.OUTSIDE: above.position[2] + 0.05,
    }
    for verdict, z in ends.items():
        found = rules.verdict_of_place(episode, jnp.int32(0), settled(rules, (0.1, 0.0, z)))
        assert Verdict(int(found)) == verdict


def test_a_region_lies_in_the_plane_of_a_slope():
    region = region_of(Rectangle((0.1, 0.05), (0.1, 0.08), 0.3), SLOPE)
    T = SLOPE.chosen.T_world_surface
    np.testing.assert_allclose(region.T_world_region.as_matrix()[:3, 2], T[:3, 2], atol=1e-6)
    center = T @ [0.1, 0.05, 0.0, 1.0]
    np.testing.assert_allclose(region.T_world_region.translation(), center[:3], atol=1e-6)
    np.testing.assert_allclose(SLOPE.region_points[0], T[:3, 3], atol=1e-9)
    assert SLOPE.lowest == pytest.approx(0.72 - 0.275 * np.sin(np.radians(10)), abs=1e-6)
    check_region(SLOPE.region, SLOPE)
    with pytest.raises(ConfigError, match="beyond"):
        check_region(Rectangle((0.0, 0.3), (0.1, 0.1)), SLOPE)
    grid = Grid.of(SLOPE, 0.1)
    np.testing.assert_allclose(grid.T_world_region, T, atol=1e-6)
    middle = tuple(side // 2 for side in grid.bare.shape)
    assert grid.bare[middle] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_on_a_slope_the_centre_of_mass_leans_downhill():
    rules = world(SLOPE).rules
    search = LowestFit(rules)
    episode = rules.begin(jax.random.key(0))
    for yaw in (0.0, 1.0):
        candidates = Candidates(jnp.zeros((1, 2)), jnp.array([yaw]))
        scene = search.scene(episode.replace(object_index=jnp.array([1, 0])))
        found = search.closely(scene, candidates)
        # 15.5 cm up, of a base of 6 cm: it tips downhill by 2.7 of its 3 cm.
        assert scene.under.lean == pytest.approx([0.0, -0.155 * np.tan(np.radians(10))], abs=1e-5)
        assert float(found.scores.support[0]) < 0.35
        assert float(found.scores.fit.rest[0]) == pytest.approx(0.155, abs=1e-5)


def test_what_cannot_stand_is_named_at_once():
    ball = prism("ball", 0.001, 0.04)
    slippery = box("slippery", (0.05, 0.05, 0.01))
    object.__setattr__(slippery, "friction", 0.1)
    tower = box("tower", (0.02, 0.02, 0.2))
    lying = box("lying", (0.02, 0.1, 0.05))
    with pytest.raises(ConfigError, match="ball, slippery, tower") as error:
        check_surface([ball, slippery, tower, lying], SLOPE, *RULES)
    assert "10.0 degrees" in str(error.value)
    giant = box("giant", (0.05, 0.05, 0.16))
    with pytest.raises(ConfigError, match="too tall") as error:
        check_surface([giant, lying], BOOKCASE.on_surface("shelf_1"), *RULES)
    assert "giant" in str(error.value)
    check_surface([lying], SLOPE, *RULES)
    check_surface([giant], BOOKCASE.on_surface("all"), *RULES)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("shelf_9", "shelf_1"),
        ("top,top", "once"),
        ("top:0", "above 0"),
        ("top:x", "above 0"),
        ("top:1,rack", "all"),
    ],
)
def test_surfaces_that_cannot_be(text, word):
    with pytest.raises(ConfigError, match=word):
        BOOKCASE.on_surface(text)


def test_surfaces_are_told_by_name_and_number():
    asked = parse_surfaces("top:3, shelf_1:4", BOOKCASE.surfaces)
    assert [(surface.name, number) for surface, number in asked] == [("top", 3), ("shelf_1", 4)]
    every = BOOKCASE.on_surface("all")
    assert len(every.asked) == 4
    assert every.lowest == BOOKCASE.surfaces[-1].position[2]
    spec = SceneSpec(support="bookcase", surface="top:3,shelf_1:4", num_objects=6)
    with pytest.raises(ConfigError, match="add up"):
        spec.problem_config("guided")


@pytest.mark.slow
def test_each_object_draws_a_surface_by_free_area_or_by_what_is_left():
    objects = [
        box("giant", (0.05, 0.05, 0.16)),
        *(box(f"low-{k}", (0.05, 0.05, 0.02)) for k in range(4)),
    ]
    keys = jax.random.split(jax.random.key(0), 400)

    def drawn(rules, episode):
        focus = rules.focus(episode)
        footprint = jnp.full(5, 0.01)
        draw = jax.vmap(lambda key: rules.surfaces.draw(key, episode, focus, footprint))
        return np.bincount(np.asarray(draw(keys)), minlength=len(rules.surfaces.area)) / len(keys)

    rules = world(BOOKCASE.on_surface("all"), objects, order="fixed").rules
    episode = rules.begin(jax.random.key(0))
    assert drawn(rules, episode)[0] == 1.0
    episode = episode.replace(slot=episode.slot + 1)
    share = np.asarray(rules.surfaces.area / rules.surfaces.area.sum())
    np.testing.assert_allclose(drawn(rules, episode), share, atol=0.08)
    rules = world(BOOKCASE.on_surface("top:1,shelf_1:4"), objects, order="fixed").rules
    # The giant waits: the only place where it fits is kept.
    episode = rules.begin(jax.random.key(0)).replace(object_index=jnp.array([1, 2, 3, 4, 0]))
    assert drawn(rules, episode)[1] == 1.0


@pytest.mark.slow
def test_scenes_on_all_boards_of_a_bookcase_stand_where_they_belong(tmp_path):
    asked = {"support": "bookcase", "surface": "top:3,shelf_1:2,shelf_3:4", "pool": "dining"}
    summary = generate(tmp_path / "bank", num_scenes=4, render=False, **asked)
    assert summary is not None
    for scene in read_scenes(read_bank(tmp_path / "bank")):
        bottom = [
            pose[2] - asset.resting[0].height
            for asset, pose in zip(scene.objects, scene.poses, strict=True)
        ]
        heights = np.array([surface.position[2] for surface in BOOKCASE.surfaces])
        on = [int(np.argmin(np.where(heights < z + 0.005, z - heights, np.inf))) for z in bottom]
        assert np.bincount(on, minlength=4).tolist() == [3, 2, 0, 4]
        assert scene.support.surface == asked["surface"]


def test_slopes_are_judged_with_the_friction_of_contacts():
    contact = ContactConfig(friction=(0.15, 0.005, 0.0001))
    with pytest.raises(ConfigError, match="slide"):
        check_surface([box("flat", (0.05, 0.05, 0.01))], SLOPE, PlacementConfig(), contact, False)
