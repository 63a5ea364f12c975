"""Studies: what they ask, their tables, findings that are kept, the results page."""

import dataclasses
import importlib.util
import json

import pytest

from cluttergen_jax.assets.support_file import list_supports
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.episodes import WITHIN
from cluttergen_jax.evaluation.measures.survival import PEERS
from cluttergen_jax.evaluation.report import document, read_results, tables_of
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.running import run_study
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.studies import furniture, table1, table2
from cluttergen_jax.evaluation.studies.findings import Findings, each_standing, row_of
from cluttergen_jax.evaluation.studies.study import Scale, Study, grid
from cluttergen_jax.evaluation.studies.survival import SURVIVAL
from cluttergen_jax.evaluation.suites import FORMER_NAMES, SUITES, find_suite
from cluttergen_jax.evaluation.trial import Trial

SMALL = Trial(num_objects=2, trials=6)
PACKAGES = {"pybullet": "pybullet", "drake": "pydrake"}


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return Runner(Store(tmp_path_factory.mktemp("results")))


# What is asked


def test_a_grid_holds_every_combination_once():
    rows = grid(SMALL, method=("random", "drop"), attempts=(1, 2, 3))
    asked = [(row.method, row.attempts) for row in rows]
    assert asked == [(m, a) for m in ("random", "drop") for a in (1, 2, 3)]
    assert {(row.num_objects, row.trials) for row in rows} == {(2, 6)}


@pytest.mark.parametrize("suite", SUITES)
def test_suites_have_trials_at_every_scale(suite):
    studies = find_suite(suite, Scale())
    names = [study.name for study in studies]
    assert len(set(names)) == len(names)
    assert all(each.trials for each in studies)
    assert all(max(t.trials for t in each.trials) == each.study.size for each in studies)
    quick = find_suite(suite, Scale(quick=True))
    assert all(t.trials <= 16 for study in quick for t in study.trials)
    # Whatever sets two rows of a study apart, its table can tell: none is made twice.
    assert all(len(set(each.trials)) == len(each.trials) for each in studies)
    assert [study.name for study in find_suite(suite, Scale(), (names[-1],))] == names[-1:]


def test_suites_ask_what_the_paper_asked():
    studies = {study.name: study.trials for study in find_suite("paper", Scale())}
    assert {t.pool for t in studies["table1"]} == set(table1.GROUP_OF_POOL)
    twins = {table1.TWINS.get(t.method, t.method) for t in studies["table1"]}
    assert twins == set(table1.PAPER)
    assert {t.trials for t in studies["table1"]} == {1000}
    assert {t.change for t in studies["table2"]} == set(table2.PAPER)
    assert {t.trials for t in studies["table2"]} == {500}
    assert len(studies["furniture"]) == 50 * (1 + len(furniture.ROWS))
    assert set(furniture.SUPPORTS) <= set(list_supports())
    assert len([t for t in studies["table1"] if t.method == "policy"]) == 15


def test_unknown_suites_and_studies_are_named():
    with pytest.raises(ConfigError, match="paper, extended"):
        find_suite("everything", Scale())
    with pytest.raises(ConfigError, match="table1"):
        find_suite("paper", Scale(), ("table9",))


@pytest.mark.parametrize(("former", "name"), FORMER_NAMES.items())
def test_former_names_of_suites_are_understood(former, name):
    assert find_suite(former, Scale()) == find_suite(name, Scale())


def test_methods_choose_rows_and_leave_out_studies_without_any():
    studies = find_suite("paper", Scale(methods=("policy",)))
    assert all({trial.method for trial in study.trials} == {"policy"} for study in studies)
    everything = {study.name for study in find_suite("paper", Scale())}
    assert everything - {study.name for study in find_suite("paper", Scale(methods=("normal",)))} >= {
        "furniture",
        "attempts",
    }


def test_imported_groups_are_a_study_of_their_own_where_they_are_at_hand():
    assert "imported" not in {study.name for study in find_suite("paper", Scale())}
    with pytest.raises(ConfigError, match="cluttergen import"):
        find_suite("paper", Scale(), ("imported",))
    (study,) = find_suite("paper", Scale(imported=(("paper_study", 9),)), ("imported",))
    assert {(trial.pool, trial.num_objects) for trial in study.trials} == {("paper_study", 9)}
    rows = [{"trial": dataclasses.asdict(trial), "missing": "none"} for trial in study.trials]
    (table,) = tables_of(result_of(study, rows))
    column = table.columns.index("paper: success")
    shown = {row[1]: row[column] for row in table.rows}
    assert shown == {"random": "0.000", "policy": "0.874"}


def test_imported_groups_stand_beside_the_papers_figures():
    assert table1.papers("policy", "paper_dining") == table1.papers("beta_free", "dining") == (0.912, 89)
    assert table1.papers("drop", "dining") is table1.papers("policy", "mine") is None


# What is shown


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
        "within": [{"times": each, "share": 0.5, "low95": 0.188, "high95": 0.812} for each in WITHIN],
        "fill": 0.75,
        "attempts": 75,
        "simulated_steps": 25926,
        "steps_by_attempt": [{"attempt": 1, **spread}, {"attempt": 2, **spread, "mean": 99.0}],
        "valid_scenes_per_cpu_second": 1.25,
    }


# By hand: Wilson's intervals of 3 and of 4 in 6; at least 1, 2 and 3 objects of three, from 1, 1, 0 and 4.
STRICT, LOOSE, AT_LEAST = "0.500 [0.188, 0.812]", "0.667 [0.300, 0.903]", ["0.833", "0.667", "0.667"]


@pytest.mark.parametrize(
    ("name", "number", "cells"),
    [
        ("table1", 5, [STRICT, LOOSE, "201.5 ± 3.0", "engine, assets, height"]),
        ("fig1a", 5, AT_LEAST),
        ("steps_by_attempt", 5, ["7", "201.5 ± 3.0", "99.0 ± 3.0", "-"]),
        ("attempts", 6, [STRICT, LOOSE, "201.5 ± 3.0"]),
        ("table2", 6, [STRICT, LOOSE]),
        ("furniture", 10, ["0.500", STRICT]),
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
        {"trial": dataclasses.asdict(t), "figures": made}
        if t.method == "random" or name == "furniture"
        else {"trial": dataclasses.asdict(t), "missing": "no checkpoint", "hint": "python train.py"}
        for t in study.trials
    ]
    result = json.loads(json.dumps(result_of(study, rows)))
    for table in tables_of(result):
        assert "quick: 6 trials" in table.title
        if name == "furniture" and table.columns[1] in furniture.ROWS:
            # A column for each of them, of the two scenes of one pool and of all ten tables' pools.
            assert table.columns[1:] == furniture.ROWS
            assert all(set(row[1:]) == {STRICT} for row in table.rows[:-1])
            continue
        assert sum(set(cells) <= set(row) for row in table.rows) == number
        assert table.csv().count("\n") == len(table.rows) + 1
        assert table.latex().count(r"\\") == len(table.rows) + 1
    page = document([result])
    assert "python evaluate.py" in page
    assert "](results/one.png)" in page
    assert ("python train.py" in page) == (name != "furniture")


def test_the_papers_figures_stand_beside_ours():
    (study,) = find_suite("paper", Scale(), ("table2",))
    rows = [{"trial": dataclasses.asdict(t), "missing": "none"} for t in study.trials]
    (table,) = tables_of(result_of(study, rows))
    column = table.columns.index("paper: success")
    shown = {row[2]: row[column] for row in table.rows if row[1] == "beta_free"}
    assert shown == {change: f"{value:.3f}" for change, value in table2.PAPER.items()}


def test_tables_of_the_authors_sizes_stand_beside_ours():
    """Each with every pool, by the paper's method as well, under a name of their own."""
    (study,) = find_suite("paper", Scale(), ("table_tops",))
    tops = {trial.support for trial in study.trials}
    assert len(tops) == 11
    assert "table-1.06x0.80" in tops
    policies = [trial for trial in study.trials if trial.paper_count]
    assert {trial.method for trial in policies} == {"beta_free", "policy"}
    assert len(policies) == 2 * 11 * 5
    made = figures(3, [1, 1, 1, 3])
    rows = [{"trial": dataclasses.asdict(t), "figures": made | {"paper": made}} for t in study.trials]
    shown = tables_of(json.loads(json.dumps(result_of(study, rows))))
    assert any("the box about the top" in note for table in shown for note in table.notes)
    assert not any("this project's" in note for table in shown for note in table.notes)


def test_values_read_off_the_papers_pictures_stand_below_ours():
    rows = {}
    for name in ("fig1a", "steps_by_attempt"):
        (study,) = find_suite("paper", Scale(), (name,))
        made = figures(3, [1, 1, 1, 3])
        made["paper"] = figures(4, [1, 1, 0, 4])
        asked = [{"trial": dataclasses.asdict(t), "figures": made} for t in study.trials]
        (table,) = tables_of(json.loads(json.dumps(result_of(study, asked))))
        rows[name] = {row[:2]: row[2:] for row in table.rows}
    assert rows["fig1a"]["the paper's", "ClutterGen"] == ("0.990", "1.000", "1.000")
    assert rows["steps_by_attempt"]["kitchen", "ClutterGen, the paper"] == (
        "-",
        "106",
        "85",
        "49",
        "48",
        "60",
    )
    # A row without a memory that falls says that the fall is selection.
    assert any("kitchen 202 to 99" in note and "selection" in note for note in table.notes)
    # One that does not fall says nothing.
    made["paper"]["steps_by_attempt"][1]["mean"] = 300.0
    (table,) = tables_of(json.loads(json.dumps(result_of(study, asked))))
    assert not any("selection" in note for note in table.notes)


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
        for trial, scenes in each_standing(runner, trials, rows):
            find = lambda trial=trial, scenes=scenes: count(trial, scenes)  # noqa: E731
            rows.append(row_of(trial, **(runner.measured(trial, "count", find) if keeps_each else find())))
        return Findings(rows)

    trials = grid(SMALL, seed=(0, 1))
    return Study("count", "counted", 6, lambda scale: trials, lambda _: [], measure, keeps_each=keeps_each)


@pytest.mark.slow
@pytest.mark.parametrize(("keeps_each", "expected"), [(True, [0, 1, 1]), (False, [0, 1, 0, 1])])
def test_findings_are_kept_one_by_one_or_all_together(runner, tmp_path, keeps_each, expected):
    asked = []
    study = counted(asked, keeps_each)
    trials = study.trials(Scale())

    def found():
        return run_study(runner, study, trials, tmp_path, "paper", "command", False)["measure"]["rows"]

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
    result = run_study(runner, SURVIVAL, (SMALL,), tmp_path, "extended", "command", False)["measure"]
    installed = [engine for engine in PEERS if importlib.util.find_spec(PACKAGES[engine])]
    assert [row["engine"] for row in result["rows"]] == installed
    assert len(result["notes"]) == len(PEERS) - len(installed)
    assert all("cluttergen_jax[peers]" in note for note in result["notes"])
