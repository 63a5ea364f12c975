"""Banks of scenes made by hand: any bank's readers read them, and they grow scene by scene."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.generation.hand import HandBank
from cluttergen_jax.placement.problem import Setup
from cluttergen_jax.placement.region import no_keep_out
from cluttergen_jax.placement.types import Start
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.stats import stats_of, stats_text
from tests.helpers.problems import trio_problem

SEED = 7


@pytest.fixture(scope="module")
def setup():
    problem = trio_problem(history_stride=0, num_objects=2, min_margin=0.003)
    return Setup(problem, no_keep_out(), Start.empty(3))


def opened(path, setup, **kinds):
    return HandBank(path, setup, (), SEED, **kinds)


def fill(bank, y=0.0):
    """A scene whose objects stand in a row; its poses."""
    scene = bank.begin()
    for place in range(len(scene.left)):
        scene.hold(0.15 * place - 0.1, y, 0.0)
        scene.lower()
        assert scene.drop().attempt.is_stable
    assert scene.check().verdict == 0
    return scene


def give_up(bank):
    """A scene of one object; the next was let go high up."""
    scene = bank.begin()
    scene.lower()
    scene.drop()
    scene.hold(0.15, 0.1, 0.0)
    scene.held = replace(scene.held, z=0.5)
    scene.drop()
    return scene


@pytest.fixture(scope="module")
def made(setup, tmp_path_factory):
    """A bank of a success, a failure and a success, and the poses that the scenes had."""
    path = tmp_path_factory.mktemp("hand") / "bank"
    kept = []
    with opened(path, setup) as bank:
        for scene in (fill, give_up, fill):
            scene = scene(bank)
            bank.keep(scene)
            kept.append((scene.all, scene.num_placed, scene.poses[scene.all], scene.clock.seconds))
        summary = bank.summary()
    return path, kept, summary


def test_the_rows_are_what_the_person_made(made):
    path, kept, _ = made
    bank = read_bank(path)
    assert bank.num_scenes == 3
    rows = bank.table.to_pylist()
    assert [row["index"] for row in rows] == [0, 1, 2]
    assert [row["is_success"] for row in rows] == [True, False, True]
    assert [row["is_filled"] for row in rows] == [True, False, True]
    names = bank.record["recipe"]["names"]
    for row, (everything, num_placed, poses, seconds) in zip(rows, kept, strict=True):
        assert row["objects"] == [names[k] for k in everything]
        assert row["is_placed"] == [k < num_placed for k in range(2)]
        np.testing.assert_array_equal(np.float32(row["poses"])[:num_placed], poses[:num_placed])
        assert row["seconds"] == np.float32(seconds) > 0
    assert rows[1]["attempts"] == [1, 1]
    assert rows[1]["verdict"] == "unsettled"
    assert rows[1]["num_unsettled"] == 1
    recipe = bank.record["recipe"]
    assert (recipe["method"], recipe["seed"], recipe["placement"]["min_margin"]) == (
        "hand",
        SEED,
        0.003,
    )
    # Nobody was asked to stop after so many.
    assert "max_attempts" not in recipe["placement"]


def test_every_reader_reads_it(made, tmp_path):
    path, _, summary = made
    assert "scenes     3, of which 2 succeed" in str(summary)
    report = cg.verify(path)
    assert report.is_sound
    assert [each.path.name for each in report.scenes] == ["000000.xml", "000002.xml"]
    stats = stats_of(read_bank(path))
    seconds = read_bank(path).table["seconds"].to_pylist()
    assert stats.hand_total == pytest.approx(sum(seconds))
    assert stats.hand_median == pytest.approx(np.median(seconds))
    text = stats_text(read_bank(path), stats)
    assert "made by hand with seed 7" in text
    assert "by hand    " in text
    assert "missing    nothing of the 3" in text
    cg.export(path, format="mjcf", out=tmp_path / "out")
    assert len(list((tmp_path / "out" / "scenes").glob("*.xml"))) == 2
    scene = jax.jit(cg.load_bank(path).reset)(jax.random.key(0))
    assert scene.is_placed.sum() == 2
    card = (path / "README.md").read_text()
    assert "| `seconds` | `float` | that the person who made the scene spent on it" in card
    assert "- method: hand" in card
    assert "- attempts per object: as many as were wanted" in card
