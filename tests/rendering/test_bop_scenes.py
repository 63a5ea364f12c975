"""Scenes of banks in a BOP dataset: each once, whole, under a number of its own. All of it without OpenGL."""

import json
from dataclasses import replace

import pyarrow as pa
import pytest

from cluttergen_jax.api.render import render
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.rollout import BLOCK_SIZE
from cluttergen_jax.views.bop import BopDataset
from tests.helpers import banks
from tests.helpers.worlds import trio


@pytest.fixture(autouse=True)
def nothing_draws(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")


def written(path, first):
    """A bank whose scene 0 stands as scene `first` of another, and so on."""
    rows = banks.rows(0).to_pydict() | {
        "poses": banks.rows(first // BLOCK_SIZE)["poses"].to_pylist()
    }
    seen = {each.name: replace(each, pieces=(Piece(each.parts[0].hull()),)) for each in trio()}
    with banks.writer(path, BLOCK_SIZE, objects=seen) as bank:
        bank.write_block(0, pa.Table.from_pydict(rows, schema=banks.SCHEMA))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("banks")


@pytest.fixture(scope="module")
def first(folder):
    return written(folder / "first", 0)


@pytest.fixture(scope="module")
def second(folder):
    return written(folder / "second", BLOCK_SIZE)


def added(bank, out, scenes="0-2", **changes):
    asked = {"bop": True, "picture": False, "views": 1, "size": "64x48", "samples": 1} | changes
    return render(bank, out, scenes=scenes, **asked)


def tree(folder):
    """What each file of a dataset holds, and when it was written."""
    files = [each for each in sorted(folder.rglob("*")) if each.is_file()]
    return {
        each.relative_to(folder).as_posix(): (each.read_bytes(), each.stat().st_ino)
        for each in files
    }


def numbers(out, split="train_synt"):
    return sorted(int(each.name) for each in (out / "bop" / split).iterdir())


def test_scenes_of_a_second_bank_are_added_and_nothing_is_made_twice(first, second, tmp_path):
    added(first, tmp_path, "0,4,2")
    assert numbers(tmp_path) == [0, 2, 4]
    before = tree(tmp_path / "bop" / "train_synt")
    report = added(second, tmp_path)
    assert [each.name for each in report.paths] == ["000005", "000006", "000007"]
    after = tree(tmp_path / "bop" / "train_synt")
    assert {name: after[name] for name in before} == before
    for number, (source, scene) in {4: ("first", 4), 5: ("second", 0), 7: ("second", 2)}.items():
        record = json.loads(
            (tmp_path / "bop" / "train_synt" / f"{number:06d}" / "origin.json").read_text()
        )
        assert (record["source"], record["scene"]) == (source, scene)
    for bank, scenes in ((second, "0-2"), (first, "0,4,2")):
        report = added(bank, tmp_path, scenes)
        assert not report.paths
        assert any("3 of 3 scenes are in" in note for note in report.notes)
    assert tree(tmp_path / "bop" / "train_synt") == after
    # The first bank's scenes keep their own numbers where these are free.
    added(first, tmp_path, "1,6,9")
    assert numbers(tmp_path) == [0, 1, 2, 4, 5, 6, 7, 8, 9]


def test_a_call_that_was_interrupted_goes_on_where_it_stopped(first, second, tmp_path, monkeypatch):
    for bank in (first, second):
        added(bank, tmp_path / "whole")
    added(first, tmp_path / "cut")
    honest = BopDataset.add
    calls = []

    def interrupted(self, number, *args):
        calls.append(number)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return honest(self, number, *args)

    with monkeypatch.context() as patch:
        patch.setattr(BopDataset, "add", interrupted)
        with pytest.raises(KeyboardInterrupt):
            added(second, tmp_path / "cut")
    assert numbers(tmp_path / "cut") == [0, 1, 2, 3]
    report = added(second, tmp_path / "cut")
    assert [each.name for each in report.paths] == ["000004", "000005"]
    whole, cut = (tree(tmp_path / name / "bop") for name in ("whole", "cut"))
    assert {name: data for name, (data, _) in whole.items()} == {
        name: data for name, (data, _) in cut.items()
    }


CONTRADICTIONS = (
    ({"views": 2}, "with views 1, and is asked for with views 2"),
    ({"seed": 1}, "seed 0, and is asked for with seed 1"),
    ({"cameras": ("overhead",)}, r"cameras None.*cameras overhead \("),
    ({"hulls": True}, "hulls False, and is asked for with hulls True"),
    ({"size": "80x60"}, "camera.json says .* one `size`"),
    ({"pixel_origin": "corner"}, "says cx 31.5, cy 23.5, and asked for is cx 32.0, cy 24.0"),
)


def test_what_contradicts_a_split_is_refused_before_any_work(first, tmp_path):
    added(first, tmp_path, "1")
    before = tree(tmp_path)
    for change, told in CONTRADICTIONS:
        with pytest.raises(ConfigError, match=told):
            added(first, tmp_path, "0,1", **change)
        assert tree(tmp_path) == before


def test_scenes_of_unknown_origin_are_not_mixed_with_others(first, tmp_path):
    added(first, tmp_path, "1")
    origin = tmp_path / "bop" / "train_synt" / "000001" / "origin.json"
    for damage in (b"{", b"{}", origin.read_bytes().replace(b'"scene": 1', b'"scene": "1"')):
        origin.write_bytes(damage)
        with pytest.raises(ConfigError, match="000001 does not say which scene it is"):
            added(first, tmp_path)
    origin.unlink()
    with pytest.raises(ConfigError, match="another `split`"):
        added(first, tmp_path)


def test_files_that_are_replaced_are_counted(first, second, tmp_path):
    asked = {"picture": False, "points": True, "scenes": "0-2"}
    assert not render(first, tmp_path, **asked).notes
    assert render(second, tmp_path, **asked).notes == (
        f"replaced 3 files of the same names that were in {tmp_path}",
    )
