"""Comparing methods and making suites: from Python, and from the command line."""

import json
from pathlib import Path

import pytest

import cluttergen_jax
from cluttergen_jax.cli.evaluate import Evaluate
from cluttergen_jax.cli.main import run
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.resolved import Checkpoints
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.running import command_of, num_failed
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.studies.study import Scale
from cluttergen_jax.learning.policies.embedded import list_policies

SUPPORTS = ("table", "round_table")


def command(tmp_path, **options):
    objects = {} if "suite" in options else {"num_objects": 2}
    return run(Evaluate(trials=4, out=str(tmp_path), **objects, **options))


def test_command_takes_up_what_was_made_before(tmp_path, capsys):
    assert command(tmp_path, methods=("random",), supports=SUPPORTS[:1]) == 0
    (first,) = json.loads((tmp_path / "results.json").read_text())
    capsys.readouterr()
    assert command(tmp_path, methods=("random",), supports=SUPPORTS) == 0
    rows = json.loads((tmp_path / "results.json").read_text())
    assert [row["support"] for row in rows] == list(SUPPORTS)
    # Its times would be others if it had been made again.
    assert rows[0] == first
    assert {path.suffix for path in tmp_path.iterdir() if path.is_file()} == {
        *(".md", ".csv", ".tex", ".json", ".png"),
    }
    shown, said = capsys.readouterr()
    assert shown.startswith("| pool | support | objects | method | success [95 %] |")
    assert "2 rows, 1 kept from before, 1 to be made\n" in said
    assert "[2 of 2 rows, " in said
    # A row that cannot be made is told below the table and by the status.
    assert (
        command(tmp_path, methods=("random", "policy"), supports=SUPPORTS[:1], checkpoints=str(tmp_path)) == 1
    )
    shown, said = capsys.readouterr()
    assert (
        "| policy | - | - | - | - | - |\n\n- no checkpoint for method 'policy' on pool 'dining'; try: "
        in shown
    )
    assert "error: 1 row could not be made; why stands below the table" in said
    assert json.loads((tmp_path / "results.json").read_text())[0] == first


def test_suites_fail_where_a_first_seed_is_missing():
    rows = [
        {"trial": {"training_seed": seed}, "missing": "no checkpoint", "hint": "train"} for seed in (0, 1)
    ]
    few = {"missing": "2 of 512 scenes succeed"}
    results = [
        {"records": [*rows, {"trial": {}, "figures": {}}], "measure": {"rows": [few]}},
        {"records": []},
    ]
    assert num_failed(results) == 1
    timed = {"missing": "the timed process failed: x", "hint": "again"}
    assert num_failed([{"records": [], "measure": {"rows": [timed]}}]) == 1


def test_a_comparison_from_python_writes_nothing_unasked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = cluttergen_jax.evaluate(["random"], supports=["table"], num_objects=2, trials=4)
    (row,) = found.rows
    assert (row["pool"], row["support"], row["method"], row["trials"]) == ("dining", "table", "random", 4)
    assert row["low95"] <= row["success"] <= row["high95"]
    assert found.table.rows[0][:4] == ("dining", "table", "2", "random")
    assert list(tmp_path.iterdir()) == []


def test_errors_name_arguments():
    with pytest.raises(ConfigError, match="num_threads"):
        cluttergen_jax.evaluate(num_threads=-1)
    with pytest.raises(ConfigError, match="supports = "):
        cluttergen_jax.evaluate(supports=())
    with pytest.raises(ConfigError, match="seeds = 0"):
        cluttergen_jax.evaluate_suite("paper", seeds=0)


def test_a_suite_from_python_hands_out_each_study_as_it_is_done(tmp_path):
    given = []
    # One scene of each row, too few to tell anything about how different scenes are.
    results = cluttergen_jax.evaluate_suite(
        "extended", only=("diversity",), methods=("random",), trials=1, out=tmp_path, show=given.append
    )
    assert given == results
    (result,) = results
    assert (result["suite"], result["name"], result["trials"]) == ("extended", "diversity", [1])
    assert [row["support"] for row in result["measure"]["rows"]] == ["table-0.60x0.70", "table-0.40x0.50"]
    assert all("of 1 scenes succeed" in row["missing"] for row in result["measure"]["rows"])
    assert json.loads((tmp_path / "diversity.json").read_text()) == result
    assert all((tmp_path / name).is_file() for name in ("diversity.md", "diversity.csv", "all.md"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pools": ("breakfast",)}, "dining"),
        ({"methods": ("magic",)}, "random"),
        ({"supports": ("moon",)}, "round_table"),
        ({"suite": "all"}, "extended"),
        ({"suite": "paper", "only": ("table3",)}, "table1"),
        ({"quick": True}, "--suite"),
        ({"checkpoints": "nowhere"}, "training runs"),
        ({"checkpoint": str(list_policies()["dining-normal"])}, "--methods normal"),
        ({"methods": ("policy",), "pools": ("study",), "max_attempts": 9}, "cluttergen train"),
        ({"suite": "paper", "only": ("table1",), "methods": ("drop",)}, "short_memory"),
        ({"supports": ()}, "one name or more"),
        ({"num_threads": -1}, "0 to 4096"),
        ({"seeds": 2}, "without a suite"),
        (
            {"suite": "paper", "supports": ("round_table",), "repeat": True},
            "--supports, --repeat with a suite",
        ),
    ],
)
def test_mistakes_are_explained(tmp_path, capsys, options, said):
    assert command(tmp_path, **options) == 2
    assert said in capsys.readouterr().err


def test_studies_name_the_command_that_makes_them():
    scale = Scale(quick=True, seeds=1, pools=("my pool", "dining"))
    runner = Runner(Store(None), Checkpoints(path=Path("runs/x")), num_threads=2)
    assert command_of("paper", "table2", scale, runner) == (
        "cluttergen evaluate --checkpoint runs/x --pools 'my pool' dining --suite paper --quick --seeds 1 "
        "--threads 2 --only table2"
    )
