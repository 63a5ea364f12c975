"""Commands that are killed, or without streams, or on a full disk, make in the end what they always make."""

import os
import random

import pytest

from tests.helpers.accidents import COMMANDS, Bench, Inputs, facts_of, why_no_disk
from tests.helpers.drawing import IS_DRAWING, STATUS

SLOW = ("generate", "import", "dataset", "train", "evaluate", "placer data")
"""Commands of which a few accidents are tried each time; the others are tried by hand."""


def bench_of(name, folder):
    """A command that has run twice without accidents."""
    if COMMANDS[name].needs_gl and not IS_DRAWING:
        pytest.skip(f"nothing here can draw: {STATUS}")
    bench = Bench(name, Inputs(folder / "inputs"), folder / "runs")
    passing = bench.measure()
    assert len(bench.usual) > 3 * len(passing), f"nearly all is of the moment: {sorted(passing)}"
    return bench


def test_a_verification_that_is_killed_is_made_whole(tmp_path):
    bench = bench_of("verify", tmp_path)
    bench.kill(random.Random(0), most=1)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", SLOW)
def test_accidents_change_nothing_of_what_is_made(name, tmp_path):
    bench = bench_of(name, tmp_path)
    draw = random.Random(name)
    bench.kill(draw)
    bench.redirect(draw)
    if why_no_disk() is None:
        bench.fill(draw)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_full_disk_is_said_and_nothing_is_lost(tmp_path):
    if (reason := why_no_disk()) is not None:
        pytest.skip(f"nothing can be mounted here: {reason}")
    bench = bench_of("export", tmp_path)
    for seed in range(2):
        bench.fill(random.Random(seed))


def test_facts_tell_files_that_differ(tmp_path):
    for folder, seconds in (("one", 1), ("two", 2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "log.csv").write_text(f"step,seconds\n1,{seconds}\n2,{seconds}\n")
        (tmp_path / folder / "a.json").write_text(f'{{"x": {{"y": [1, {seconds}], "z": 3}}}}')
    os.symlink("a.json", tmp_path / "two" / "link")
    one, two = (facts_of(tmp_path / folder) for folder in ("one", "two"))
    assert {key for key in one | two if one.get(key) != two.get(key)} == {
        "log.csv:seconds",
        "a.json:.x.y.1",
        "link",
        "link:",
    }
