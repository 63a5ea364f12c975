"""Suites from Python and from the command line: `python evaluate.py --suite`."""

import inspect
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from cluttergen_jax import config
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.kept_folder import FolderLock
from studies.api import evaluate_suite
from studies.command import main
from studies.suites import SUITES
from tests.helpers.options import options_in

ROOT = Path(__file__).parents[2]
OPTIONS = json.loads((Path(__file__).parent / "options.json").read_text())


def test_choices_are_all_that_there_is():
    assert get_args(config.Suite) == tuple(SUITES)


def test_a_suite_has_the_options_and_defaults_that_it_has_had(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["--help"]) == 0
    assert options_in(capsys.readouterr().out) == OPTIONS


def test_every_argument_is_explained():
    told = inspect.getdoc(evaluate_suite).split("Args:")[-1]
    for argument in inspect.signature(evaluate_suite).parameters:
        assert re.search(rf"\b{argument}\b", told), argument


def test_evaluate_in_a_checkout_makes_suites_and_compares(capsys):
    program = ROOT / "evaluate.py"
    evaluate = runpy.run_path(str(program))["evaluate"]
    assert evaluate(["--suite", "paper", "--only", "nothing", "--out", os.devnull]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    plain = subprocess.run(
        [sys.executable, str(program), "--help"], capture_output=True, text=True, check=False
    )
    assert "usage: cluttergen evaluate" in plain.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--suite", "paper", "--bank", "bank"], "--bank with suite 'paper'"),
        (["--suite", "downstream", "--methods", "drop"], "--methods with suite 'downstream'"),
        (["--suite", "paper", "--only", "tabel1"], "Did you mean 'table1'?"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_the_words_of_the_command(
    words, said, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert said in capsys.readouterr().err
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_file_in_the_place_of_the_folder_is_explained(tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    assert main(["--suite", "paper", "--quick", "--out", str(taken)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert str(taken) in said
    assert "Try: " in said
    assert taken.read_text() == "mine"


@pytest.mark.parametrize("suite", [["paper"], ["downstream", "--only", "noise"]])
def test_a_second_writer_is_refused_before_it_changes_anything(suite, tmp_path, capsys):
    lock = FolderLock(tmp_path / "out")
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    assert main(["--suite", *suite, "--quick", "--out", str(tmp_path / "out")]) == 2
    assert f"is being written by process {os.getpid()} on" in capsys.readouterr().err
    after = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    assert after == before
    lock.release()


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda: evaluate_suite("downstream", pools="dining"), "pools = 'dining'"),
        (lambda: evaluate_suite("paper", trials="x"), "trials = 'x'"),
        (lambda: evaluate_suite("nothing"), "paper, extended, downstream"),
    ],
)
def test_python_is_told_what_it_gave(ask, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        ask()
    assert not list(tmp_path.iterdir())


def test_a_suite_from_python_hands_out_each_study_as_it_is_done(tmp_path):
    given = []
    # One scene of each row, too few to tell anything about how different scenes are.
    results = evaluate_suite(
        "extended",
        only=("diversity",),
        methods=("random",),
        trials=1,
        out=tmp_path,
        show=given.append,
    )
    assert given == results
    (result,) = results
    assert (result["suite"], result["name"], result["trials"]) == ("extended", "diversity", [1])
    assert [row["support"] for row in result["measure"]["rows"]] == [
        "table-0.60x0.70",
        "table-0.40x0.50",
    ]
    assert all("of 1 scenes succeed" in row["missing"] for row in result["measure"]["rows"])
    assert json.loads((tmp_path / "diversity.json").read_text()) == result
    assert all((tmp_path / name).is_file() for name in ("diversity.md", "diversity.csv", "all.md"))
