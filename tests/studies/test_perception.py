"""Training and judging the observer from the command line: `python -m studies.perception`."""

import inspect
import json
import os
import re
from pathlib import Path

import pytest

from cluttergen_jax.kept_folder import FolderLock
from studies.perception import api
from studies.perception.__main__ import main
from tests.helpers.options import options_in

OPTIONS = json.loads((Path(__file__).parent / "perception_options.json").read_text())
WORDS = {
    "data": ["data", "--pool", "dining", "--arm", "0"],
    "train": ["train", "views"],
    "eval": ["eval", "views"],
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_command_has_the_options_and_defaults_that_it_has_had(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert main([name, "--help"]) == 0
    assert options_in(capsys.readouterr().out) == OPTIONS[name]


@pytest.mark.parametrize("name", WORDS)
def test_every_argument_is_explained(name):
    function = getattr(api, f"perception_{name}")
    told = inspect.getdoc(function).split("Args:")[-1]
    for argument in inspect.signature(function).parameters:
        assert re.search(rf"\b{argument}\b", told), argument


@pytest.mark.parametrize("name", WORDS)
def test_a_second_writer_is_refused_before_it_changes_anything(name, tmp_path, capsys):
    lock = FolderLock(tmp_path / "out")
    words = [str(tmp_path / "out") if word == "views" else word for word in WORDS[name]]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"is being written by process {os.getpid()} on" in said
    lock.release()
    assert not [path for path in (tmp_path / "out").rglob("*") if path.name != ".lock"]


def test_a_place_that_is_no_folder_is_explained(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    taken = tmp_path / "taken"
    taken.write_text("mine")
    for out, told in ((str(taken), str(taken)), ("file:///views", "a folder on this machine")):
        assert main(["data", "--out", out]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert told in said
    assert taken.read_text() == "mine"
