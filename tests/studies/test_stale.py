"""Rows say by which code and content they were made, and are told apart from what would be made now."""

import copy

import pytest

from cluttergen_jax.evaluation.comparison import table_of
from cluttergen_jax.evaluation.records import CHANGED
from cluttergen_jax.evaluation.runner import NUM_FIRST, Runner
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial
from studies import stale
from studies.pages import pivot
from studies.running import run_study
from studies.study import Study


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return Runner(Store(tmp_path_factory.mktemp("results")))


@pytest.fixture
def row(runner, monkeypatch):
    made = copy.deepcopy(runner.row(Trial.of(method="clear", num_objects=2, trials=6)))
    # As if it were of a commit from which nothing differs.
    made["commit"] = "0123456789ab"
    monkeypatch.setattr(stale, "changed_code", lambda commit: ())
    return made


def state(row, runner, probe=False):
    return stale.state_of(row, "front", runner, probe).state


def test_a_row_names_its_rules_and_first_scenes(row):
    rules = row["rules"]
    assert rules["budget"] == 10
    assert rules["max_attempts"] == 5
    assert row["sources"]["pool"]
    assert all(len(each) == min(NUM_FIRST, 6) for each in row["first"].values())
    assert sum(row["first"]["success"]) == row["figures"]["num_success"]
    assert sum(row["first"]["attempts"]) == row["figures"]["attempts"]


def test_a_study_keeps_where_its_rows_come_from(runner, tmp_path):
    study = Study("one", "One", 6, lambda scale: [])
    trials = [Trial.of(method="clear", num_objects=2, trials=6)]
    result = run_study(runner, study, trials, tmp_path, "paper", "a command", quick=False)
    (row,) = result["records"]
    assert {"sources", "rules", "first", "date", "commit"} <= set(row)
    assert "commit" in result


def test_what_has_not_changed_is_fine(row, runner):
    assert state(row, runner) == stale.CURRENT
    assert state(row | {"commit": None}, runner) == stale.UNKNOWN
    assert state(row | {"commit": f"0123456789ab{CHANGED}"}, runner) == stale.MAY_HAVE


def test_other_code_may_have_moved_a_row_and_its_first_scenes_tell(row, runner, monkeypatch):
    monkeypatch.setattr(stale, "changed_code", lambda commit: ("cluttergen_jax/physics/native.py",))
    assert state(row, runner) == stale.MAY_HAVE
    assert state(row, runner, probe=True) == stale.SAME
    row["first"]["attempts"][0] += 1
    assert state(row, runner, probe=True) == stale.MOVED


def test_other_content_has_moved_a_row(row, runner):
    row["sources"] = row["sources"] | {"pool": "another"}
    found = stale.state_of(row, "front", runner, probe=False)
    assert (found.state, found.why) == (stale.MOVED, "another pool")


def test_a_commit_that_is_not_here_is_unknown(row, runner, monkeypatch):
    monkeypatch.setattr(stale, "changed_code", lambda commit: None)
    assert state(row, runner) == stale.UNKNOWN


def learned(row, attempts):
    return row | {"policy": {"attempts": attempts}}


def test_unequal_budgets_stand_in_a_column(row):
    alike = table_of("", (), [learned(row, 100), learned(row, 100), row])
    assert "training attempts" not in alike.columns
    told = table_of("", (), [learned(row, 100_352), learned(row, 2_500_000), row])
    assert told.columns == ("training attempts",)
    assert told.rows == (("100,352",), ("2,500,000",), ("-",))
    larger = row | {"rules": row["rules"] | {"budget": 40}}
    assert table_of("", (), [row, larger]).rows == (("10",), ("40",))


def test_a_page_shows_success_by_question_and_method(row):
    table = pivot(
        [row, row | {"missing": "x"} | {"figures": {"success": 0.25}}], "case", lambda r: "a"
    )
    assert table.columns == ("case", "`clear`")
    assert table.rows[0][0] == "a"
    assert table.rows[0][1].endswith(", 0.250")
