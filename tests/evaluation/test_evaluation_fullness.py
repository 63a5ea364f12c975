"""Studies about fullness: rules of rows, rungs by fill, unseen objects, and who is as good as `guided`."""

import dataclasses
import json

import numpy as np
import pytest

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.config import TRUSTED_METHODS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation import resolved
from cluttergen_jax.evaluation.rankings import ranking_of, success_notes, tally
from cluttergen_jax.evaluation.report import tables_of
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.running import run_study
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.studies import density, held_out, robustness
from cluttergen_jax.evaluation.studies.rules import margin_of, named_rows, own_rules, with_seeds
from cluttergen_jax.evaluation.studies.study import Scale
from cluttergen_jax.evaluation.suites import STUDIES, find_suite
from cluttergen_jax.evaluation.trial import Trial, key_of, trial_of
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.proportions import wilson

SMALL = Trial(num_objects=2, trials=4)
NAMES = (
    "drop",
    "drop, ruin",
    "spread",
    "spread, random order",
    "guided",
    "guided, robust",
    "drop, ruin, robust",
)
PAPERS = ("table1", "table2", "fig1a", "steps_by_attempt", "attempts", "acceptance", "closed_loop")


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return Runner(Store(tmp_path_factory.mktemp("results")))


@pytest.mark.parametrize("name", NAMES)
def test_rows_are_called_what_they_were_asked_as(name):
    (trial,) = named_rows([SMALL], name)
    assert trial.row_name == name
    assert trial.min_margin == MIN_MARGIN


def test_rows_of_older_results_are_called_by_their_methods():
    assert trial_of({"trial": {"method": "policy"}}).row_name == "policy"
    assert margin_of([{"trial": {"method": "policy"}}]) == ", no support margin asked for"


def test_unknown_rules_are_named():
    with pytest.raises(ConfigError, match="random order"):
        named_rows([SMALL], "drop, upside down")


def test_a_budget_and_new_fields_do_not_lose_what_was_kept():
    assert own_rules(dataclasses.replace(SMALL, budget=9, method="drop")).budget == 9
    sources = {"pool": "a"}
    assert key_of(SMALL, sources) != key_of(dataclasses.replace(SMALL, robust=True), sources)


@pytest.mark.parametrize("name", PAPERS)
def test_tables_of_the_paper_keep_its_rules(name):
    for trial in STUDIES[name].trials(Scale()):
        assert (trial.order, trial.ruin_after, trial.min_margin, trial.budget) == ("random", 0, 0.0, None)


@pytest.mark.parametrize(
    "name", ["density", "crowds", "unseen", "diversity", "robustness", "survival", "time"]
)
def test_rows_of_other_tables_ask_for_one_margin(name):
    trials = STUDIES[name].trials(Scale())
    assert {trial.min_margin for trial in trials} == {MIN_MARGIN}
    names = {trial.row_name for trial in trials}
    assert set(TRUSTED_METHODS) <= names


def test_crowds_hold_equal_rows_with_and_without_taking_away():
    trials = density.crowds(Scale())
    of_number = {number: {t.row_name for t in trials if t.num_objects == number} for number in (20, 30, 40)}
    assert of_number[30] == of_number[40] == set(density.FULLNESS)
    assert of_number[20] == set(density.FULLNESS) | {
        f"{method}, random order{tidy}" for method in ("spread", "guided") for tidy in ("", ", tidy")
    }
    assert {t.budget for t in trials if t.num_objects == 40} == {400}


@pytest.mark.parametrize("fill", density.FILLS)
def test_tables_by_fill_are_filled_by_so_much(runner, fill):
    trial = dataclasses.replace(SMALL, pool="all", num_objects=20, support=density.filled_table(fill))
    width, depth = 2 * np.asarray(runner.resolve(trial).region.half_extents)
    boxes = [
        np.ptp(np.concatenate([part.vertices for part in each.parts])[:, :2], axis=0)
        for each in find_pool("all").objects
    ]
    mean = np.mean([x * y for x, y in boxes])
    # Sides are in whole centimetres.
    assert 20 * mean / (width * depth) == pytest.approx(fill, rel=0.02)
    assert depth / width == pytest.approx(7 / 6, rel=0.05)


def test_training_seeds_are_rows_of_the_method_that_has_them():
    trials = with_seeds(named_rows([SMALL], "drop", "guided"), "guided", 3)
    assert [(t.method, t.training_seed) for t in trials] == [("drop", 0), *(("guided", n) for n in range(3))]
    assert len(with_seeds(trials[:2], "guided", None)) == 2


def test_imported_groups_are_merged_where_they_are_at_hand():
    pools = [t.pool for t in held_out.trials(Scale(imported=(("paper_a", 10), ("paper_b", 7))))]
    assert list(dict.fromkeys(pools)) == ["held_out_families", "training_families", "paper_a+paper_b"]
    (last, *_) = [
        t for t in held_out.trials(Scale(imported=(("paper_a", 10), ("paper_b", 7)))) if "+" in t.pool
    ]
    assert last.num_objects == 17
    assert len(held_out.trials(Scale())) == 6


@pytest.mark.slow
def test_pools_of_variants_need_no_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path))
    monkeypatch.setattr(resolved, "NUM_VARIANTS", 1)
    monkeypatch.setitem(resolved.VARIANT_POOLS, "held_out_families", ("sticky_notes",))
    pool = resolved.find_any_pool("held_out_families")
    assert pool.names == ("sticky_notes-5000",)
    trial = dataclasses.replace(SMALL, pool="held_out_families", num_objects=1, method="random", repeat=True)
    row = Runner(Store(None)).row(trial)
    assert row["figures"]["success"] == 1.0
    assert row["trial"]["pool"] == "held_out_families"


def rows_of(**successes):
    """Rows of a hundred scenes with so many successes, by name of row."""
    found = []
    for name, good in successes.items():
        (trial,) = named_rows([SMALL], name.replace("_", ", "))
        low, high = wilson(good, 100)
        figures = {
            "trials": 100,
            "num_success": good,
            "success": good / 100,
            "low95": low,
            "high95": high,
            "attempts_per_valid_scene": 1000 / good,
            "simulated_steps_per_valid_scene": 2000 / good,
        }
        found.append({"trial": dataclasses.asdict(trial), "figures": figures})
    return found


def test_rankings_are_read_from_the_rows():
    rows = rows_of(guided=80, spread=79, drop=20, drop_ruin=99)
    found = ranking_of(rows)
    assert (found.better, found.equal, found.worse) == (("drop, ruin",), ("spread",), ("drop",))
    (note,) = success_notes(rows, lambda row: "two objects")
    assert "as good (intervals overlap): `spread`" in note
    assert "better: `drop, ruin`" in note
    assert note.endswith("0.99, 0.99")
    told = tally(rows, lambda row: "two objects")
    assert told.startswith("`guided` is ahead of all others in 0 of 1 comparisons; ")
    assert told.endswith("as good: `spread` in 1; better: `drop, ruin` in 1")
    # Nothing is said of a method that has no row.
    assert tally(rows[1:], lambda row: "two objects") == ""
    assert ranking_of(rows[1:]) is None
    assert success_notes(rows[1:], lambda row: "two objects") == []


def test_what_was_asked_of_the_clutter_stands_beside_what_was_got():
    (planned,) = find_suite("extended", Scale(), ("dial",))
    rows = []
    for trial in planned.trials:
        (row,) = rows_of(spread=100)
        figures = row["figures"] | {"stack": {"mean": 1.5, "std": 0.5}}
        rows.append({"trial": dataclasses.asdict(trial), "figures": figures})
    result = {"name": "dial", "title": "t", "records": rows}
    (table,) = planned.study.tables(result)
    of_guided = [row for row in table.rows if row[1] == "guided"]
    asked, error = (table.columns.index(name) for name in ("objects on others, asked", "error"))
    assert [row[asked] for row in of_guided] == ["nothing", "0", "1", "2", "3", "4", "5"]
    # By hand: 1.5 for 1, 2 and 3; of nothing and of 0 there is no share.
    assert [row[error] for row in of_guided][:5] == ["-", "-", "+50%", "-25%", "-50%"]
    assert all(trial.order == "weighted" for trial in planned.trials)


def made_by(runner, tmp_path, name, method, **changed):
    """The tables of a study's rows of one method, made small."""
    (planned,) = find_suite("extended", Scale(trials=4), (name,))
    trials = [t for t in planned.trials if t.method == method]
    trials = tuple(dict.fromkeys(dataclasses.replace(t, **changed) for t in trials))
    result = run_study(runner, planned.study, trials, tmp_path, "extended", "command", False)
    return json.loads(json.dumps(result))


@pytest.mark.slow
def test_crowds_are_made_with_spread(runner, tmp_path):
    asked = {"num_objects": 2, "budget": None, "pool": "dining", "order": "random", "ruin_after": 0}
    asked |= {"tidy": True}
    result = made_by(runner, tmp_path, "crowds", "spread", **asked)
    assert len(result["records"]) == 1
    (table,) = tables_of(result)
    assert "support margin of 3 mm" in table.title
    (row,) = table.rows
    assert row[table.columns.index("method")] == "spread, random order, tidy"
    assert row[table.columns.index("within 5 n")].startswith("1.000")


def test_crowded_rows_of_robust_scenes_have_a_quarter_of_the_trials():
    (planned,) = find_suite("extended", Scale(), ("stability",))
    assert {(trial.num_objects, trial.trials) for trial in planned.trials} == {(10, 256), (30, 64)}


@pytest.mark.slow
def test_robust_scenes_stand_beside_others(runner, tmp_path):
    same = {"num_objects": 2, "pool": "dining", "support": "table", "clutter": "", "order": "random"}
    result = made_by(runner, tmp_path, "stability", "spread", **same, ruin_after=0, trials=4)
    rows = result["measure"]["rows"]
    assert [row["method"] for row in rows] == ["spread, random order", "spread, random order, robust"]
    assert all(0 <= row["robust"]["share"] <= 1 for row in rows)
    assert [each["degrees"] for each in rows[0]["tilt"]] == list(robustness.DEGREES)
    (table,) = tables_of(result)
    assert len(table.rows) == 2
