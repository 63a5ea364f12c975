"""Pairs on disk: resumed to the same bytes, honest about what was seen, refused where something is wrong."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream.noise import REALSENSE
from cluttergen_jax.downstream.placer import pair_maker as data
from cluttergen_jax.downstream.placer import pairs
from cluttergen_jax.downstream.placer.bench import Bench
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.pairs import load_queries, read_pairs
from cluttergen_jax.downstream.placer.query import Proposals
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import BankError
from cluttergen_jax.placement.heightmap import VOID
from cluttergen_jax.types import Verdict
from tests.helpers.placing import write_bank
from tests.helpers.records import unsigned

WIDTH = 8
"""Pairs of a block here."""


@pytest.fixture(scope="module", autouse=True)
def small_blocks():
    with pytest.MonkeyPatch.context() as patch:
        for module in (data, pairs):
            patch.setattr(module, "PAIRS", replace(pairs.PAIRS, block_size=WIDTH))
        patch.setattr(pairs.PairSet, "form", pairs.PAIRS)
        yield


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("banks") / "test", seed=SPLITS["test"])


@pytest.fixture(scope="module")
def made(bank, tmp_path_factory):
    """Twelve pairs of the split test: a block, and half of one."""
    return cg.placer_data(tmp_path_factory.mktemp("pairs") / "whole", bank.path, camera="overhead")


@pytest.fixture(scope="module")
def loaded(made):
    return load_queries(made, split="test")


def blocks(folder):
    return {file.name: file.read_bytes() for file in folder.glob("*.parquet")}


def test_a_run_that_was_stopped_goes_on_to_the_same_bytes(bank, made, tmp_path, monkeypatch):
    block = data.PairMaker.block
    stopped = []

    def stop(maker, number, *rest):
        if number == 1 and not stopped:
            stopped.append(number)
            raise KeyboardInterrupt
        return block(maker, number, *rest)

    monkeypatch.setattr(data.PairMaker, "block", stop)
    with pytest.raises(KeyboardInterrupt):
        cg.placer_data(tmp_path / "pairs", bank.path, camera="overhead")
    assert list(blocks(tmp_path / "pairs")) == ["test-000000.parquet"]
    # A block that a disk has damaged is made again, too.
    with (tmp_path / "pairs" / "test-000000.parquet").open("r+b") as file:
        file.seek(2000)
        file.write(b"damaged")
    cg.placer_data(tmp_path / "pairs", bank.path, camera="overhead")
    assert blocks(tmp_path / "pairs") == blocks(made.path)
    assert read_pairs(tmp_path / "pairs").record == made.record


def test_splits_share_neither_cameras_nor_noise(bank, tmp_path, monkeypatch):
    train = write_bank(tmp_path / "train")
    for each in (bank, train):
        both = cg.placer_data(tmp_path / "pairs", each.path, num_pairs=4)
    cameras = [
        next(iter(both.tables(split)))["T_region_camera"].to_pylist() for split in both.splits
    ]
    assert both.splits == ("test", "train")
    assert not any(one == other for one, other in zip(*cameras, strict=True))
    see = QueryMaker.see_all
    streams = []

    def spied(maker, views, noise, rng):
        streams.append(rng.bit_generator.seed_seq.entropy)
        return see(maker, views, noise, rng)

    monkeypatch.setattr(QueryMaker, "see_all", spied)
    for split in both.splits:
        load_queries(both, REALSENSE, 0, split)
    assert len(set(streams)) == 8
    assert set(streams) > {(0, pair) for pair in range(4)}, "training sees what it always saw"
    # As an earlier version made them: with the draws of the training split.
    record = json.loads((both.path / "pairs.json").read_text())
    record["splits"]["test"]["seed"] = 0
    (both.path / "pairs.json").write_text(json.dumps(unsigned(record)))
    with pytest.raises(BankError, match=r"made with another seed.*overwrite"):
        cg.placer_data(both.path, bank.path, num_pairs=4)


def test_queries_show_what_stands_to_the_millimetre(loaded):
    queries, labels = loaded
    from cluttergen_jax.downstream.placer.map_from_depth import CELL

    for row, slot in enumerate(labels.num_standing):
        heights = queries.heights.height[row]
        corner = queries.heights.corner[row]
        for pose in labels.poses[row, :slot]:
            i, j = ((pose[:2] - corner) / CELL).astype(int)
            assert heights[i, j] == pytest.approx(2 * pose[2], abs=0.0015)
        if not slot:
            assert np.abs(heights[heights > VOID]).max() < 0.0015
        assert (queries.ceilings.height[row] >= heights).all()
        kept = queries.cloud[row][queries.cloud_mask[row]]
        assert len(kept) > 500
        assert not queries.cloud[row][~queries.cloud_mask[row]].any()
        assert kept[:, 2].max() <= heights.max() + 0.002


@pytest.mark.slow
def test_candidates_are_judged_as_the_bench_judges_proposals(made, loaded):
    labels = loaded[1]
    assert (labels.verdict == int(Verdict.STABLE)).mean() > 0.4
    assert len(np.unique(labels.verdict)) > 1
    bench = Bench(made.setup("test"), labels)
    first = Proposals(labels.candidate[:, 12:13], np.zeros((len(labels.pair), 1), np.float32))
    outcome = bench.judge(first)
    told = labels.verdict[:, 12].astype(int)
    is_strict = outcome.verdict[:, 0] != int(Verdict.CREPT)
    assert is_strict.mean() > 0.8
    assert np.array_equal(outcome.verdict[is_strict, 0], told[is_strict])


def test_splits_share_no_scene():
    """A scene's key is fold_in(key(seed), index); seeds of splits lie in ranges of their own."""
    seeds = [first + more for first in SPLITS.values() for more in (0, 1, 2, 999_999)]
    keys = {
        tuple(
            np.asarray(
                jax.random.key_data(jax.random.fold_in(jax.random.key(seed), index))
            ).tolist()
        )
        for seed in seeds
        for index in (0, 1, 2, 3, 499, 999_999, 1_000_000, 2_000_000)
    }
    assert len(keys) == 8 * len(seeds)
