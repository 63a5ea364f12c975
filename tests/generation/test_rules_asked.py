"""The rules that generate, make_sampler, make_env and evaluate resolve alike from what they are given."""

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.config import VerifyConfig
from cluttergen_jax.generation.sources.replay import setup_of
from cluttergen_jax.generation.sources.scene_sources import open_source
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.placement.methods.table import TRUSTED
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.card import card_text
from cluttergen_jax.scene.bank.stats import stats_of
from cluttergen_jax.spec import MARGIN_FOR, SceneSpec

RULES = ("order", "ruin_after", "budget", "min_margin")
PAPER = {"order": "random", "ruin_after": 0, "budget": None, "min_margin": 0.0}


def rules(method, **asked):
    decided = SceneSpec(**asked).with_rules(method)
    return {name: getattr(decided, name) for name in RULES}


@pytest.mark.parametrize("method", [*TRUSTED, "drop", None])
def test_the_papers_rules_hold_whatever_the_method(method):
    assert rules(method, setting="paper") == PAPER


@pytest.mark.parametrize("setting", ["default", "paper"])
@pytest.mark.parametrize("method", [TRUSTED[0], "drop"])
def test_what_is_given_wins(setting, method):
    given = {"order": "fixed", "ruin_after": 0, "budget": 70, "min_margin": 0.0}
    assert rules(method, setting=setting, **given) == given


@pytest.mark.parametrize("setting", ["default", "paper"])
@pytest.mark.parametrize("engine", MARGIN_FOR)
def test_another_engine_asks_for_a_margin_unless_one_is_given(engine, setting):
    asked = {"setting": setting, "for_engine": engine}
    assert rules("guided", **asked)["min_margin"] == MARGIN_FOR[engine] > MIN_MARGIN
    assert rules(None, **asked)["min_margin"] == MARGIN_FOR[engine]
    assert rules("guided", **asked, min_margin=0.001)["min_margin"] == 0.001


@pytest.fixture(scope="module")
def ruined(tmp_path_factory, pool):
    """A bank of four of the trio on a tiny table, objects taken away where it is stuck."""
    out = tmp_path_factory.mktemp("ruined") / "bank"
    rules = {"order": "weighted", "ruin_after": 2, "max_attempts": 4}
    asked = {
        "support": "table-0.09x0.12",
        "num_objects": 4,
        "repeat": True,
        "method": "drop",
        "seed": 7,
    }
    return cg.generate(out, pool=pool, num_scenes=24, render=False, max_files=2, **asked, **rules)


@pytest.mark.slow
def test_a_bank_with_ruin_says_so_and_adds_up(ruined):
    bank = read_bank(ruined.path)
    record = bank.record["recipe"]["placement"]
    assert (record["order"], record["ruin_after"], record["min_margin"]) == (
        "weighted",
        2,
        MIN_MARGIN,
    )
    attempts = np.array(bank.table["attempts"].to_pylist())
    assert attempts.max() > 2
    assert attempts.sum(1).max() <= 16
    stats = stats_of(bank)
    assert stats.attempts == attempts.sum() == sum(each.attempts for each in stats.objects)
    assert "- failed attempts after which objects are taken away: 2" in card_text(bank, stats)


@pytest.mark.slow
def test_a_bank_with_ruin_is_replayed_and_verified(ruined):
    source, _ = open_source(str(ruined.path))
    attempts = np.array(read_bank(ruined.path).table["attempts"].to_pylist())
    row = int(attempts.sum(1).argmax())
    recording = source.replay(row)
    assert len(recording.attempts) == attempts[row].sum()
    assert any(len(recording.taken_away(number)) for number in range(len(recording.attempts)))
    assert all(found.stands for found in cg.verify(ruined.path, VerifyConfig(seconds=1.0)).scenes)


@pytest.mark.slow
def test_a_bank_in_a_polygon_is_set_up_in_that_polygon(tmp_path, pool):
    corners = "-0.2,-0.2;0.2,-0.2;0.0,0.2"
    asked = {"num_objects": 2, "method": "drop", "region": corners}
    bank = cg.generate(
        tmp_path / "bank", pool=pool, num_scenes=2, render=False, max_files=0, **asked
    )
    source, _ = open_source(str(bank.path))
    np.testing.assert_allclose(
        setup_of(source.bank).problem.rules.polygon,
        [[-0.2, -0.2], [0.2, -0.2], [0, 0.2]],
        atol=1e-7,
    )
    assert len(source.replay(0).attempts) >= 2
