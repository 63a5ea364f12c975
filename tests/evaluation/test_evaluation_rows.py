"""Rows of trials: kept on disk, found again by content, missing where a policy is."""

import json

import numpy as np
import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.comparison import compare
from cluttergen_jax.evaluation.resolved import Checkpoints, MissingCheckpointError, MissingRowError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial, key_of

SMALL = Trial.of(num_objects=2, trials=6)


def test_keys_follow_content():
    sources = {"pool": "a", "checkpoint": None}
    assert key_of(SMALL, sources) == key_of(SMALL.replace(), dict(sources))
    others = [SMALL.replace(seed=1), SMALL.replace(max_attempts=4)]
    keys = {key_of(each, sources) for each in [SMALL, *others]} | {
        key_of(SMALL, sources | {"pool": "b"})
    }
    assert len(keys) == 4
    # A pool that lies elsewhere is the same pool: its hash is among the sources.
    assert key_of(SMALL.replace(pool="copy/of/dining"), sources) == key_of(SMALL, sources)


@pytest.mark.parametrize(
    ("trial", "name"),
    [
        (SMALL, "dining-table-random-2-objects-5-attempts-k.json"),
        (
            Trial.of(method="policy", training_seed=1, change="all", min_margin=0.003),
            "dining-table-policy-seed-1-all-margin-3-mm-10-objects-5-attempts-k.json",
        ),
    ],
)
def test_files_of_rows_are_called_by_what_they_ask(tmp_path, trial, name):
    assert Store(tmp_path).path(trial.title, "k") == tmp_path / name


def test_store_sets_damaged_files_aside(tmp_path):
    said = []
    store = Store(tmp_path, said.append)
    assert store.read("row", "k") is None
    store.write("row", "k", {"figures": {"success": 1.0}}, {"poses": np.ones(3)})
    assert store.read("row", "k")["figures"] == {"success": 1.0}
    np.testing.assert_array_equal(store.read_arrays("row", "k")["poses"], np.ones(3))
    for path in (store.path("row", "k"), store.path("row", "k").with_suffix(".npz")):
        path.write_bytes(path.read_bytes()[:20])
    assert store.read("row", "k") is None
    assert store.read_arrays("row", "k") is None
    assert len(said) == 2
    assert len(list(tmp_path.glob("*.damaged"))) == 2


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return Runner(Store(tmp_path_factory.mktemp("results")))


def test_rows_are_kept_with_both_counts(runner):
    trial = SMALL.replace(paper_count=True, whole_attempts=True)
    row = runner.row(trial)
    assert runner.row(trial) == row == runner.stored_row(trial)
    figures = row["figures"]
    assert figures["paper"]["trials"] == figures["trials"] == 6
    # Nothing is judged less strictly than the paper's count, and two objects never fail it here.
    assert figures["paper"]["success"] >= figures["success"]
    arrays = runner.arrays(trial)
    assert arrays["is_success"].mean() == figures["success"]
    assert arrays["poses"].shape == (6, 2, 7)


def test_a_row_that_fails_leaves_the_others(tmp_path, monkeypatch):
    make = Runner.make

    def fails_on_margin(self, resolved):
        if resolved.trial.spec.min_margin:
            raise ConfigError("min_margin here", "none", "another")
        return make(self, resolved)

    monkeypatch.setattr(Runner, "make", fails_on_margin)
    runner = Runner(Store(tmp_path))
    bad = SMALL.replace(min_margin=0.003)
    runner.plan([bad, SMALL])
    found = compare(runner, [bad, SMALL], tmp_path)
    assert [row["success"] is None for row in found.rows] == [True, False]
    assert found.num_missing == 1
    assert set(found.table.rows[0][4:]) == {"-"}
    assert found.table.notes == ("min_margin here (allowed: none); try: another",)
    with pytest.raises(MissingRowError, match="min_margin here"):
        runner.arrays(bad)
    with pytest.raises(ConfigError, match="min_margin here"):
        compare(runner, [bad], None)


def test_checkpoints_are_found_by_pool_variant_and_seed(tmp_path):
    record = {
        "format": 1,
        "network": {},
        "placement": {"max_attempts": 5, "history_stride": 12},
        "stability": {"stop_when_decided": True},
    }
    for name in ("dining-policy-0/policy", "dining-policy-1/policy", "dining-normal"):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        (folder / "record.json").write_text(json.dumps(record))
        (folder / "weights.npz").write_bytes(b"weights")
    found = Checkpoints(folder=tmp_path)
    policy = SMALL.replace(method="policy")
    assert found.find(policy).path == tmp_path / "dining-policy-0/policy"
    assert found.find(policy.replace(training_seed=1)).path == tmp_path / "dining-policy-1/policy"
    assert found.find(policy.replace(method="normal")).path == tmp_path / "dining-normal"
    with pytest.raises(MissingCheckpointError):
        found.find(policy.replace(training_seed=2))
    other = policy.replace(max_attempts=2)
    assert found.find(other).path == tmp_path / "dining-policy-0/policy"
    (tmp_path / "dining-policy-0").rename(tmp_path / "dining-policy-attempts2-0")
    assert found.find(other).path == tmp_path / "dining-policy-attempts2-0/policy"
    # What cannot be used is said in the row, and the suite goes on.
    for damage in ({}, {"network": None}):
        (tmp_path / "dining-policy-attempts2-0/policy/record.json").write_text(
            json.dumps(record | damage)
        )
        row = Runner(Store(tmp_path / "results"), found).row(other)
        assert "cannot be used" in row["missing"]
        assert str(tmp_path) not in row["missing"]
