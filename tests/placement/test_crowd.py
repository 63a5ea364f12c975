"""Crowds as users ask for them: what is refused, what is asked, and scenes that every door gives alike."""

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.clutter import Clutter
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.stats import stats_of


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"crowd": 2.0}, "0 to 1"),
        ({"crowd": -0.1}, "0 to 1"),
        ({"crowd": float("nan")}, "0 to 1"),
        ({"crowd": True}, "0 to 1"),
        ({"crowd": 0.5, "clutter": "side=1"}, "one or the other"),
        ({"clutter": "lean=2"}, "0 to 1"),
    ],
)
def test_a_crowd_is_a_share(options, words):
    with pytest.raises(ConfigError, match=words):
        cg.SceneSpec(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "pile"}, "makes each scene at once"),
        ({"method": "settle"}, "makes each scene at once"),
        ({"engine": "warp"}, "engine"),
        ({"start": "bank:0"}, "start"),
        ({"surface": "all", "support": "bookcase"}, "surface"),
        ({"num_objects": 1}, "one object"),
        ({"support": "tilted_board_5"}, "slope"),
    ],
)
def test_what_cannot_be_drawn_together_is_refused_before_work(options, words):
    with pytest.raises(ConfigError, match=words):
        cg.make_sampler(crowd=0.5, **{"method": "random", **options})


def test_the_dial_is_one_of_targets():
    def targets(**options):
        return PlacementConfig(num_objects=10, **options).crowd_targets

    assert targets() is None
    assert targets(clutter="stack=2") is None
    assert targets(crowd=0.5) == (1.0, 0.0)
    assert targets(crowd=0.25) == pytest.approx((0.5, 0.0))
    assert targets(crowd=1) == pytest.approx((1.0, 0.4))
    assert targets(clutter="side=0.7,stack=2") == (0.7, 0.0)
    # Two objects have one pair.
    assert PlacementConfig(num_objects=2, crowd=0.5).crowd_targets == (0.5, 0.0)


def test_a_draw_does_not_see_what_is_drawn_together_later():
    assert Clutter.of("side=1,stack=2").for_draw == Clutter.of("stack=2")
    assert Clutter.of("side=1,lean=0.5").for_draw is None
    with pytest.raises(ConfigError, match="side"):
        Clutter.of("side=6").check(10)


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    out = tmp_path_factory.mktemp("crowd") / "bank"
    spec = cg.SceneSpec(
        method="clear", crowd=0.5, num_objects=5, region="0.50x0.50", keep_out=("0.2,0.2,0.1,0.1",)
    )
    cg.generate(out, spec, num_scenes=6, seed=4, render=False, max_files=0)
    return read_bank(out)


def test_a_bank_says_how_its_scenes_crowd(bank):
    assert bank.recipe["placement"]["crowd"] == 0.5
    rows = bank.table
    is_success = np.array(rows["is_success"])
    assert is_success.sum() >= 5
    beside = np.array(rows["num_beside"])[is_success]
    assert beside.mean() >= 3
    known = {each.name: each for each in stats_of(bank).clutter}
    assert known["side"].got == pytest.approx(beside.mean() / 5)
    assert known["lean"].got <= 0.2


def test_objects_of_a_crowd_lie_in_the_region_and_out_of_boxes(bank):
    poses = np.array(bank.table["poses"].to_pylist())[np.array(bank.table["is_success"])]
    assert (np.abs(poses[..., :2]) <= 0.25 + 1e-6).all()
    assert not (np.abs(poses[..., :2] - 0.2) < 0.05).all(-1).any()


def test_a_crowd_is_made_again_from_its_recipe(bank):
    spec = cg.SceneSpec.from_recipe(bank.recipe)
    assert spec.crowd == 0.5


def test_a_sampler_makes_crowds_like_any_scene():
    sample = cg.make_sampler(method="random", crowd=0.5, num_objects=4, region="0.40x0.40")
    scene = jax.jit(sample)(jax.random.key(3))
    assert bool(scene.is_success)
    assert int(scene.num_beside) >= 1
    assert int(scene.num_leaning) == 0
