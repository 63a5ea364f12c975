"""Studies: what they ask, their tables, findings that are kept, the results page."""

import importlib.util
import json

import pytest

from cluttergen_jax.assets.support_file import list_supports
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.runner import WITHIN, Runner
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial, grid
from studies.measures.survival import PEERS
from studies.methods import table1, tables
from studies.methods.paper_figures import at_least
from studies.methods.robustness import SURVIVAL
from studies.report import document, read_results, tables_of
from studies.running import run_study
from studies.study import Findings, Scale, Study, each_success, row_of
from studies.suites import find_suite

SMALL = Trial.of(num_objects=2, trials=6)
PACKAGES = {"pybullet": "pybullet", "drake": "pydrake"}


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return Runner(Store(tmp_path_factory.mktemp("results")))


# What is asked


def test_suites_ask_what_the_paper_asked():
    studies = {study.name: study.trials for study in find_suite("paper", Scale())}
    assert {t.pool for t in studies["table1"]} == set(table1.GROUP_OF_POOL)
    twins = {table1.TWINS.get(t.method, t.method) for t in studies["table1"]}
    assert twins == set(table1.PAPER)
    assert {t.trials for t in studies["table1"]} == {1000}
    assert {t.change for t in studies["table2"]} == set(tables.PAPER_BY_CHANGE)
    assert {t.trials for t in studies["table2"]} == {500}
    assert len(studies["furniture"]) == 50 * (1 + len(tables.ROWS))
    assert set(tables.SUPPORTS) <= set(list_supports())
    assert len([t for t in studies["table1"] if t.method == "policy"]) == 15


# What is shown


def test_shares_of_at_least_so_many_objects_fall_to_the_filled_scenes():
    histogram = [1, 0, 3, 4]
    shares = at_least(histogram)
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == 4 / 8


def result_of(planned, rows, measure=None):
    study = planned.study
    return {
        "format": 1,
        "suite": "paper",
        "name": study.name,
        "title": study.title,
        "command": "python evaluate.py",
        "quick": True,
        "size": study.size,
        "trials": [6],
        "date": "2000-01-01",
        "machine": {
            "cores": 1,
            "cpu": "none",
            "accelerator": None,
            "python": "3",
            "versions": {"mujoco": "3"},
        },
        "records": rows,
        "measure": measure,
        "pictures": ["one.png", "one.pdf"],
    }


def figures(num_success, histogram):
    """Figures of six scenes of three objects."""
    spread = {"count": 7, "mean": 201.5, "std": 3.0, "quartiles": [200.0, 201.0, 203.0]}
    return {
        "trials": 6,
        "num_success": num_success,
        "success": num_success / 6,
        "low95": 0.188,
        "high95": 0.812,
        "placed": 2.25,
        "placed_histogram": histogram,
        "attempts_per_valid_scene": 12.5,
        "simulated_steps_per_valid_scene": 4321.0,
        "stable_steps": spread,
        "within": [
            {"times": each, "share": 0.5, "low95": 0.188, "high95": 0.812} for each in WITHIN
        ],
        "fill": 0.75,
        "attempts": 75,
        "simulated_steps": 25926,
        "steps_by_attempt": [{"attempt": 1, **spread}, {"attempt": 2, **spread, "mean": 99.0}],
        "valid_scenes_per_cpu_second": 1.25,
    }


# By hand: Wilson's intervals of 3 and of 4 in 6; at least 1, 2 and 3 objects of three, from 1, 1, 0 and 4.
STRICT = "0.500 [0.188, 0.812]"
LOOSE = "0.667 [0.300, 0.903]"
AT_LEAST = ["0.833", "0.667", "0.667"]


@pytest.mark.parametrize(
    ("name", "number", "cells"),
    [
        ("table1", 1, [STRICT, LOOSE, "201.5 ± 3.0", "engine, assets, height"]),
        ("fig1a", 1, AT_LEAST),
        ("steps_by_attempt", 1, ["7", "201.5 ± 3.0", "99.0 ± 3.0", "-"]),
        ("attempts", 2, [STRICT, LOOSE, "201.5 ± 3.0"]),
        ("table2", 2, [STRICT, LOOSE]),
        ("furniture", 2, ["0.500", STRICT]),
        ("density", 6, [STRICT, "0.75", "12.5", "4,321", "1.2"]),
    ],
)
def test_tables_hold_every_row_and_say_quick(name, number, cells):
    suite = "extended" if name == "density" else "paper"
    (study,) = find_suite(suite, Scale(quick=True), (name,))
    made = figures(3, [1, 1, 1, 3])
    if name != "furniture":
        made["paper"] = figures(4, [1, 1, 0, 4])
    rows = [
        {"trial": t.fields(), "figures": made}
        if t.method == "random" or name == "furniture"
        else {"trial": t.fields(), "missing": "no checkpoint", "hint": "python train.py"}
        for t in study.trials
    ]
    result = json.loads(json.dumps(result_of(study, rows)))
    for table in tables_of(result):
        # Of density every row is made.
        assert f"quick: {'' if name == 'density' else 'fewer rows, '}6 trials" in table.title
        if name == "furniture" and table.columns[1] in tables.ROWS:
            # A column for each of them, of the two scenes of one pool and of all ten tables' pools.
            assert table.columns[1:] == tables.ROWS
            assert all(set(row[1:]) == {STRICT} for row in table.rows[:-1])
            continue
        assert sum(set(cells) <= set(row) for row in table.rows) == number
        assert table.csv().count("\n") == len(table.rows) + 1
        assert table.latex().count(r"\\") == len(table.rows) + 1
    page = document([result])
    assert "python evaluate.py" in page
    assert "](results/one.png)" in page
    assert ("python train.py" in page) == (name != "furniture")


def test_damaged_results_are_named(tmp_path):
    (tmp_path / "table1.json").write_text("{")
    with pytest.raises(ConfigError, match=r"table1\.json"):
        read_results(tmp_path)


# What is measured


def counted(asked, keeps_each):
    """A study that counts scenes that stand, and is interrupted at the second one that it is asked for."""

    def count(trial, scenes):
        asked.append(trial.seed)
        if len(asked) == 2:
            raise KeyboardInterrupt
        return {"scenes": len(scenes)}

    def measure(runner, trials, stem):
        rows = []
        for trial, scenes in each_success(runner, trials, rows):
            find = lambda trial=trial, scenes=scenes: count(trial, scenes)  # noqa: E731
            rows.append(
                row_of(trial, runner.measure(trial, "count", find) if keeps_each else find())
            )
        return Findings(rows)

    trials = grid(SMALL, seed=(0, 1))
    return Study(
        "count", "counted", 6, lambda scale: trials, measure=measure, keeps_each=keeps_each
    )


@pytest.mark.slow
@pytest.mark.parametrize(("keeps_each", "expected"), [(True, [0, 1, 1]), (False, [0, 1, 0, 1])])
def test_findings_are_kept_one_by_one_or_all_together(runner, tmp_path, keeps_each, expected):
    asked = []
    study = counted(asked, keeps_each)
    trials = study.trials(Scale())

    def found():
        return run_study(runner, study, trials, tmp_path, "paper", "command", False)["measure"][
            "rows"
        ]

    with pytest.raises(KeyboardInterrupt):
        found()
    rows = found()
    assert [row["scenes"] for row in rows] == [6, 6]
    assert asked == expected
    # Once more, and nothing is measured again.
    assert found() == rows
    assert asked == expected


@pytest.mark.slow
def test_survival_asks_the_engines_that_are_installed(runner, tmp_path):
    result = run_study(runner, SURVIVAL, (SMALL,), tmp_path, "extended", "command", False)[
        "measure"
    ]
    installed = [engine for engine in PEERS if importlib.util.find_spec(PACKAGES[engine])]
    assert [row["engine"] for row in result["rows"]] == installed
    assert len(result["notes"]) == len(PEERS) - len(installed)
    assert all("'.[peers]'" in note for note in result["notes"])
