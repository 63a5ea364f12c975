"""Pairs on disk: resumed to the same bytes, honest about what was seen, refused where something is wrong."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream.placer import scene_cameras
from cluttergen_jax.downstream.placer.evaluation.bench import Bench
from cluttergen_jax.downstream.placer.examples import TESTING, ExampleSource
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.pairs import maker as data
from cluttergen_jax.downstream.placer.pairs import store as pairs
from cluttergen_jax.downstream.placer.pairs.store import labels_of, load_queries, of_tenths, read_pairs
from cluttergen_jax.downstream.placer.query import Proposals
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.heightmap import VOID
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.bank import index_bytes
from cluttergen_jax.sensing.noise import NOISE_OFF, REALSENSE
from cluttergen_jax.types import Verdict
from tests.helpers import banks
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


def test_the_first_pairs_are_the_same_however_many_are_made(bank, made, tmp_path):
    few = cg.placer_data(tmp_path / "few", bank.path, camera="overhead", num_pairs=3)
    assert pq.read_table(few.path / "test-000000.parquet") == pq.read_table(
        made.path / "test-000000.parquet"
    ).slice(0, 3)
    more = cg.placer_data(tmp_path / "few", bank.path, camera="overhead", num_pairs=12)
    assert blocks(more.path) == blocks(made.path)


def test_fewer_pairs_than_an_interrupted_call_asked_for_are_a_whole_folder(bank, made, tmp_path, monkeypatch):
    block = data.PairMaker.block
    with monkeypatch.context() as patch:
        patch.setattr(data.PairMaker, "block", lambda *asked: block(*asked) if asked[1] == 0 else 1 / 0)
        with pytest.raises(ZeroDivisionError):
            cg.placer_data(tmp_path / "pairs", bank.path, camera="overhead")
    cg.placer_data(tmp_path / "pairs", bank.path, camera="overhead", num_pairs=3)
    assert blocks(tmp_path / "pairs") == blocks(made.path)


def test_splits_share_neither_cameras_nor_noise(bank, tmp_path, monkeypatch):
    train = write_bank(tmp_path / "train")
    for each in (bank, train):
        both = cg.placer_data(tmp_path / "pairs", each.path, num_pairs=4)
    cameras = [next(iter(both.tables(split)))["T_region_camera"].to_pylist() for split in both.splits]
    assert both.splits == ("test", "train")
    assert not any(one == other for one, other in zip(*cameras, strict=True))
    see, streams = QueryMaker.see_all, []

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


def test_a_pair_tells_of_the_scene_that_it_is_of(bank, made):
    rows = [row for table in made.tables("test") for row in table.to_pylist()]
    scenes = {scene.index: scene for scene in bank.scenes()}
    assert {(row["scene"], row["slot"]) for row in rows} == {(i, k) for i in scenes for k in range(3)}
    for row in rows:
        scene, slot = scenes[row["scene"]], row["slot"]
        assert row["object"] == scene.objects[slot]
        assert row["standing"] == list(scene.objects[:slot])
        top = np.array([0, 0, bank.support.top, 0, 0, 0, 0])
        assert row["target_pose"] == pytest.approx(scene.poses[slot] - top, abs=1e-6)
        labels = np.frombuffer(row["labels"], np.uint8)
        # From above every object shows, and nothing else.
        assert set(labels) == {0, 1, *range(2, 2 + slot)}


def test_queries_show_what_stands_to_the_millimetre(loaded):
    queries, labels = loaded
    from cluttergen_jax.downstream.placer.map_from_depth import CELL

    for row, slot in enumerate(labels.num_standing):
        heights, corner = queries.heights.height[row], queries.heights.corner[row]
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


def test_wanted_pairs_alone_are_read(made, loaded):
    queries, labels = load_queries(made, split="test", wanted=of_tenths(1, 9))
    assert labels.pair.tolist() == [1, 9, 11]
    assert np.array_equal(queries.heights.height, loaded[0].heights.height[[1, 9, 11]])
    with pytest.raises(ConfigError, match="no wanted pairs among 2"):
        load_queries(made, split="test", num_pairs=2, wanted=of_tenths(7))


@pytest.mark.parametrize("held_out", ["scenes", "pairs"])
def test_what_validates_is_not_learned_from(made, held_out):
    """Of pairs that stand in for a training split: by scenes, or as the paper has it by pairs."""
    table = pa.table({"pair": np.arange(200), "scene": np.arange(200) * 7 % 31})
    source = ExampleSource((made.path,), held_out=held_out)
    learned, validates = (source._filter_of(made, split)(table) for split in ("train", "val"))
    assert not (learned & validates).any()
    assert validates.any()
    shared = np.intersect1d(np.asarray(table["scene"])[learned], np.asarray(table["scene"])[validates])
    tested = of_tenths(TESTING)(table)
    if held_out == "scenes":
        assert len(shared) == 0
        assert (learned | validates).all()
    else:
        assert len(shared) > 0, "that is what the study `protocol` is about"
        assert (learned.sum(), validates.sum(), tested.sum()) == (160, 20, 20)
        assert not (tested & (learned | validates)).any()


def test_noise_is_drawn_by_the_seed_when_pairs_are_read(made, loaded):
    quiet, again = loaded[0], load_queries(made, NOISE_OFF, 9, "test", 4)[0]
    assert np.array_equal(quiet.heights.height[:4], again.heights.height)
    noisy = [load_queries(made, REALSENSE, seed, "test", 4)[0].heights.height for seed in (1, 1, 2)]
    assert np.array_equal(noisy[0], noisy[1])
    assert not np.array_equal(noisy[0], noisy[2])
    assert not np.array_equal(noisy[0], quiet.heights.height[:4])
    is_top = quiet.heights.height[:4] > VOID
    assert np.median(np.abs(noisy[0] - quiet.heights.height[:4])[is_top]) < 0.004


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
        tuple(np.asarray(jax.random.key_data(jax.random.fold_in(jax.random.key(seed), index))).tolist())
        for seed in seeds
        for index in (0, 1, 2, 3, 499, 999_999, 1_000_000, 2_000_000)
    }
    assert len(keys) == 8 * len(seeds)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"split": "train"}, r"split = 'train'.*seed is 2000000.*'test'"),
        ({"pool": "dining"}, "`pool` together with `bank`"),
        ({"num_pairs": 0}, "num_pairs = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"seed": 1_000_000}, "seed = 1000000"),
        ({"camera": "behind"}, "camera 'behind'.*overhead"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(bank, tmp_path, options, match):
    with pytest.raises(ConfigError, match=match):
        cg.placer_data(tmp_path / "pairs", bank.path, **options)
    assert not blocks(tmp_path)


def test_a_folder_of_something_else_is_left_alone(bank, made, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(BankError, match="holds no pairs"):
        cg.placer_data(tmp_path / "mine", bank.path)
    with pytest.raises(BankError, match="holds no pairs"):
        cg.placer_data(tmp_path / "mine")
    assert len(list((tmp_path / "mine").iterdir())) == 1, "nor is a bank made in it"
    with pytest.raises(BankError, match="made with another camera"):
        cg.placer_data(made.path, bank.path, camera="free")


def test_banks_of_which_no_pairs_can_be_made_are_named(tmp_path):
    with pytest.raises(BankError, match="is not a bank"):
        cg.placer_data(tmp_path / "pairs", tmp_path)
    # The made-up bank's record does not tell what its scenes were made on.
    banks.two_scenes(tmp_path / "made-up")
    with pytest.raises(BankError, match="how it was made is not recorded whole"):
        cg.placer_data(tmp_path / "pairs", tmp_path / "made-up")
    record = read_bank(tmp_path / "made-up").record
    del record["assets"]
    (tmp_path / "made-up" / "bank.json").write_bytes(index_bytes(record))
    with pytest.raises(BankError, match="no digests of its assets"):
        cg.placer_data(tmp_path / "pairs", tmp_path / "made-up")
    write_bank(tmp_path / "failed", 1, is_success=False)
    with pytest.raises(BankError, match="none of its scenes stands"):
        cg.placer_data(tmp_path / "pairs", tmp_path / "failed")


@pytest.mark.parametrize(("make", "more"), [(cg.placer_data, {}), (cg.perception_data, {"arm": 0.0})])
def test_a_bank_made_along_is_made_anew_where_that_is_asked(make, more, tmp_path, monkeypatch):
    asked = []

    def generate(out, *spec, **settings):
        asked.append(settings["overwrite"])
        raise BankError("enough")

    monkeypatch.setattr("cluttergen_jax.api.generate.generate", generate)
    for overwrite in (False, True):
        with pytest.raises(BankError, match="enough"):
            make(tmp_path, pool="dining", overwrite=overwrite, **more)
    assert asked == [False, True]


def test_a_camera_that_is_inside_the_support_is_named(bank, tmp_path, monkeypatch):
    monkeypatch.setattr(scene_cameras, "_is_inside", lambda camera, support: True)
    with pytest.raises(ConfigError, match="inside the support or does not see it"):
        cg.placer_data(tmp_path / "pairs", bank.path)


def test_what_is_no_folder_of_pairs_or_lacks_a_split_is_named(made, tmp_path):
    with pytest.raises(BankError, match=r"no pairs\.json"):
        read_pairs(tmp_path)
    with pytest.raises(ConfigError, match=r"no pairs of the split 'train'.*test"):
        load_queries(made)
    with pytest.raises(ConfigError, match="num_pairs = 13"):
        load_queries(made, split="test", num_pairs=13)
    (tmp_path / "pairs.json").write_text(json.dumps(made.record | {"format": 99}))
    with pytest.raises(BankError, match="of format 1"):
        read_pairs(tmp_path)
    (tmp_path / "pairs.json").write_text(json.dumps(made.record))
    with pytest.raises(BankError, match=r"test-000000\.parquet is missing"):
        list(read_pairs(tmp_path).tables("test"))
    table = next(iter(made.tables("test")))
    with pytest.raises(BankError, match="objects that its record does not"):
        labels_of(table, {"box": 0}, 3)


def test_the_card_names_columns_licences_and_verdicts(made):
    text = (made.path / "README.md").read_text()
    assert "license: apache-2.0" in text
    assert "test-*.parquet" in text
    assert "stable" in text
    assert "`candidate_verdict`" in text
    assert "Apache-2.0" in text


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on_to_the_same_bytes(tmp_path):
    """Blocks of 256 pairs, as users have them; SIGKILL in the middle of one."""
    bank = write_bank(tmp_path / "bank", 8)
    code = "import sys, cluttergen_jax as cg; cg.placer_data(sys.argv[1], sys.argv[2], num_pairs=600)"

    def begin(name):
        return subprocess.Popen([sys.executable, "-c", code, tmp_path / name, bank.path])

    killed, first = begin("killed"), tmp_path / "killed" / "train-000000.parquet"
    while not first.exists():
        assert killed.poll() is None
        time.sleep(0.1)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    assert len(blocks(tmp_path / "killed")) < 3
    assert begin("killed").wait() == 0
    assert begin("whole").wait() == 0
    assert len(blocks(tmp_path / "whole")) == 3
    assert blocks(tmp_path / "killed") == blocks(tmp_path / "whole")
