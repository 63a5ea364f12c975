"""Natural draws: usual turns, what carries nothing, what is drawn at all, and scenes as a whole."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.assets.sense import UNUSUAL
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.region import action_of_pose
from cluttergen_jax.placement.search import CLEARANCE
from cluttergen_jax.spec import SceneSpec
from cluttergen_jax.types import Verdict
from tests.helpers.problems import try_action

DEGREES = np.radians(5.0)
SEATS = {"-y": (0, -1), "+y": (0, 1), "-x": (-1, 0), "+x": (1, 0)}


@cache
def rules_of(*objects, pool="all", is_natural=True, **rules):
    placement = PlacementConfig(
        num_objects=len(objects), order="fixed", history_stride=0, natural=is_natural, **rules
    )
    return make_problem(ProblemConfig(pool=pool, objects=objects, placement=placement)).rules


def yaws_of(rules, number=400):
    """Turns that candidates of the first object have, radians."""
    placer = make_proposer("spread", rules)
    episode = rules.begin(jax.random.key(0))
    scene = placer.search.scene(episode, with_owner=True)
    return np.asarray(rules.natural.yaws(jax.random.key(1), scene, number))


def off_edges(yaw):
    return np.abs((yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4)


@pytest.mark.slow
def test_boxes_are_mostly_along_the_edges_and_not_always():
    share = np.mean(off_edges(yaws_of(rules_of("stapler"))) < DEGREES)
    # 0.8, and a ninth of the rest by chance: 0.822, give or take five standard deviations.
    assert share == pytest.approx(0.822, abs=5 * np.sqrt(0.822 * 0.178 / 400))


@pytest.mark.parametrize("seat", SEATS)
def test_fronts_face_the_seat(seat):
    yaw = yaws_of(rules_of("laptop", seat=seat))
    # The front is the object's -y side.
    front = np.stack([np.sin(yaw), -np.cos(yaw)], axis=1)
    assert np.all(front @ SEATS[seat] > np.cos(np.radians(26)))


@pytest.mark.slow
def test_fronts_face_the_seat_in_relations_too():
    rules = rules_of("laptop", "mouse", relations=("mouse right_of laptop",))
    placer = make_proposer("spread", rules)
    found = jax.jit(placer.candidates)(jax.random.key(1), rules.begin(jax.random.key(0)))
    yaw = np.asarray(found.found.candidates.yaw)
    assert np.all(np.cos(yaw) > np.cos(np.radians(26)))


@pytest.mark.parametrize("seat", ["-y", "+x"])
def test_forks_point_to_the_seat(seat):
    yaw = yaws_of(rules_of("fork", seat=seat))
    along = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    assert np.mean(np.abs(along @ SEATS[seat]) > np.cos(DEGREES)) > 0.7


def test_what_is_round_is_turned_anyhow():
    # Of uniform turns a ninth is within 5 degrees of an edge.
    assert np.mean(off_edges(yaws_of(rules_of("bowl"))) < DEGREES) < 0.2


def stacked(is_natural, lower, upper):
    """The verdict of an object that is let go over the middle of another."""
    rules = rules_of(lower, upper, is_natural=is_natural)
    episode = rules.begin(jax.random.key(0))
    height = 0.0
    for _ in range(2):
        body = rules.body(episode)
        position = jnp.array([0.0, 0.0, height + body.height + CLEARANCE])
        action = action_of_pose(position, 0.0, episode.region, rules.height_range(episode))
        episode, transition = try_action(rules, episode, action)
        height += 2 * body.half_extents[2]
    return Verdict(int(transition.verdict))


def test_what_carries_nothing_carries_nothing():
    assert stacked(False, "toaster", "hole_punch") == Verdict.STABLE
    assert stacked(True, "toaster", "hole_punch") == Verdict.UNRELATED


def test_what_stands_tall_usually_carries_nothing():
    """A box of cereals carries a letter tray in its table of weights only while it lies."""
    rules = rules_of("cereal_box", "soup_can", "hardback_book", "sticky_notes")
    episode = rules.begin(jax.random.key(0))
    boxes, notes = (0, 3)
    natural = rules.natural.replace(log_on=jnp.zeros((4, 4)), log_in=jnp.full((4, 4), -20.0))
    upright = natural._log_carried(episode, rules.geometry, notes)
    lying = jnp.array([0.0, 0.0, 0.8, np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
    placed = episode.replace(
        poses=episode.poses.at[boxes].set(lying),
        is_placed=episode.is_placed.at[boxes].set(True),
    )
    assert upright[boxes] == pytest.approx(np.log(UNUSUAL))
    assert natural._log_carried(placed, rules.geometry, notes)[boxes] == 0.0
    # A book is flat.
    assert upright[2] == 0.0


def test_what_belongs_on_no_table_is_drawn_last():
    placement = PlacementConfig(num_objects=2, history_stride=0, natural=True)
    objects = ("mug", "bowl", "fork")
    problem = make_problem(ProblemConfig(pool="dining", objects=objects, placement=placement))
    natural = problem.rules.natural.replace(on_table=jnp.array([True, False, True]))
    rules = problem.rules.replace(natural=natural)
    drawn = jax.vmap(rules.begin)(jax.random.split(jax.random.key(0), 20)).object_index
    assert not np.isin(drawn, 1).any()


def test_without_natural_there_is_nothing_of_it():
    assert rules_of("mug", "bowl", is_natural=False).natural is None


def test_a_seat_that_is_no_side_is_refused():
    with pytest.raises(ConfigError, match=r"seat = 'y'.*Allowed: -y, \+y, -x, \+x"):
        SceneSpec(natural=True, seat="y")


def test_weights_may_be_labels_and_nouns():
    spec = SceneSpec(pool="all", weights={"cup.n.01": 3, "coffee mug": 0.5, "label=*book*": 2})
    assert spec.weights == "cup.n.01=3.0; label=coffee mug=0.5; label=*book*=2.0"
    config = spec.problem_config("spread")
    assert config.weights[0] == ("cup.n.01", 3.0)


def test_a_theme_leaves_its_objects():
    config = SceneSpec(pool="all", theme="breakfast").problem_config("spread")
    assert {"mug", "bowl", "cereal_box"} <= {*config.objects}
    assert "laptop" not in config.objects
    with pytest.raises(ConfigError, match=r"theme 'tools'.*pool 'dining'"):
        SceneSpec(theme="tools").problem_config("spread")
