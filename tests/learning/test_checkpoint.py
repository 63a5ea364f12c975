"""Stored weights: every array of the network is there, finite, of its shape and type, or its name is told."""

import json
import zipfile

import jax
import numpy as np
import pytest

from cluttergen_jax.downstream.fitting import FitConfig
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.learning.agents import ENCODER
from cluttergen_jax.learning.ppo.checkpoint import check_folder, read_policy, save_policy
from cluttergen_jax.learning.training.run import with_encoder
from tests.helpers.records import unsigned

KERNEL, BIAS = "params/actor/kernel", "params/actor/bias"
LIKE = {
    "params": {
        "actor": {"kernel": np.zeros((4, 3), np.float32), "bias": np.zeros(3, np.float32)},
        "critic": {"kernel": np.full((4, 1), 7, np.float32)},
    }
}


@pytest.fixture
def folder(tmp_path):
    params = jax.tree.map(lambda leaf: leaf + 0.5, LIKE)
    save_policy(tmp_path / "policy", params, {})
    return tmp_path / "policy"


def change(folder, **changes):
    """Stores the weights once more, with arrays by name put in, or taken out for None."""
    with np.load(folder / "weights.npz", allow_pickle=False) as stored:
        weights = {name: stored[name] for name in stored.files} | changes
    np.savez(folder / "weights.npz", **{name: value for name, value in weights.items() if value is not None})


def test_sound_weights_are_read_and_the_critic_is_left(folder):
    params = read_policy(folder, LIKE)["params"]
    np.testing.assert_array_equal(params["actor"]["kernel"], np.full((4, 3), 0.5))
    np.testing.assert_array_equal(params["critic"]["kernel"], LIKE["params"]["critic"]["kernel"])
    assert params["actor"]["bias"].dtype == np.float32


def test_equal_arrays_are_stored_once(tmp_path):
    half = np.random.default_rng(0).normal(size=(64, 64)).astype(np.float16).astype(np.float32)
    params = {"one": {"kernel": half}, "two": {"kernel": half.copy()}, "three": {"kernel": -half}}
    save_policy(tmp_path, params, {})
    with zipfile.ZipFile(tmp_path / "weights.npz") as archive:
        sizes = {each.filename: each.file_size for each in archive.infolist()}
    assert sizes["two/kernel.npy"] < 500 < half.size < sizes["one/kernel.npy"]
    jax.tree.map(
        np.testing.assert_array_equal, read_policy(tmp_path, jax.tree.map(np.zeros_like, params)), params
    )


def test_weights_of_earlier_versions_are_read(folder):
    change(folder, **{KERNEL: np.full((4, 3), 0.25, np.float16)})
    with pytest.raises(PoolError, match="not the weights that record"):
        read_policy(folder, LIKE)
    record = folder / "record.json"
    record.write_text(json.dumps(unsigned(json.loads(record.read_text()))))
    assert (read_policy(folder, LIKE)["params"]["actor"]["kernel"] == 0.25).all()


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        (KERNEL, np.array("params/nowhere/kernel"), r"shape \(\)"),
        (BIAS, None, "missing"),
        (BIAS, np.array([0, np.nan, 0], np.float16), "not finite"),
        (BIAS, np.array([0, np.inf, 0], np.float32), "not finite"),
        (KERNEL, np.zeros((3, 4), np.float16), r"shape \(3, 4\)"),
        (BIAS, np.zeros(3, np.int32), "type int32"),
        (BIAS, np.zeros(3, np.complex64), "type complex64"),
        ("params/actor/more", np.zeros(3, np.float16), "none of the network's"),
        (BIAS, np.zeros(100_000, np.float16), "bytes"),
    ],
)
def test_what_is_wrong_is_named(folder, name, value, says):
    change(folder, **{name: value})
    with pytest.raises(PoolError, match=says) as caught:
        read_policy(folder, LIKE)
    assert repr(name) in str(caught.value)


def test_no_weights_at_all_are_no_weights(folder):
    change(folder, **{BIAS: None, KERNEL: None})
    with pytest.raises(PoolError, match=r"bias' is missing; array .*kernel' is missing"):
        read_policy(folder, LIKE)


def test_a_bomb_is_not_unpacked(folder):
    # 64 MB of zeros in a file of 64 kB: refused by its size, before it is in memory.
    with (
        zipfile.ZipFile(folder / "weights.npz", "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open("params/critic/kernel.npy", "w") as file,
    ):
        for _ in range(64):
            file.write(bytes(1 << 20))
    with pytest.raises(PoolError, match="67108864 bytes"):
        read_policy(folder, LIKE)


def test_weights_of_an_encoder_are_looked_at_too(tmp_path):
    net = {"Dense_0": {"kernel": np.ones((3, 2), np.float32), "bias": np.ones(2, np.float32)}}
    save_policy(tmp_path, net, {"encoder": "pointnet", "features": 2})
    params = {"params": {ENCODER: {"object_net": net, "scene_net": net}}}
    with_encoder(params, tmp_path)
    change(tmp_path, **{"Dense_0/bias": np.full(2, np.nan, np.float16)})
    with pytest.raises(PoolError, match="'Dense_0/bias' holds numbers that are not finite"):
        with_encoder(params, tmp_path)
    change(tmp_path, **{"Dense_0/bias": None})
    with pytest.raises(PoolError, match="'Dense_0/bias' is missing"):
        with_encoder(params, tmp_path)


def test_a_folder_of_something_else_is_no_place_for_a_run(tmp_path):
    for name in (".hidden.json", "train.log", "metrics.csv"):
        (tmp_path / name).write_text("")
    check_folder(tmp_path, {})
    check_folder(tmp_path / "new", {})
    (tmp_path / "bank.json").write_text("{}")
    for place in (tmp_path, tmp_path / "bank.json"):
        with pytest.raises(ConfigError, match=r"bank\.json is nothing of a run.*another `out`"):
            check_folder(place, {})


@pytest.mark.parametrize(
    "wrong", [{"learning_rate": float("inf")}, {"num_epochs": 0.5}, {"batch_size": 2.5}, {"num_epochs": 0}]
)
def test_a_fit_has_whole_epochs_and_finite_steps(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        FitConfig(**wrong)
