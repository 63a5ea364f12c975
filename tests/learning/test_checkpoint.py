"""Stored weights: every array of the network is there, finite, of its shape and type, or its name is told."""

import errno
import zipfile

import jax
import numpy as np
import pytest

from cluttergen_jax.errors import PoolError
from cluttergen_jax.learning.ppo import checkpoint
from cluttergen_jax.learning.ppo.checkpoint import read_policy, read_state, save_policy, save_state
from tests.helpers.accidents import small_disk, why_no_disk

KERNEL = "params/actor/kernel"
BIAS = "params/actor/bias"
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
    np.savez(
        folder / "weights.npz",
        **{name: value for name, value in weights.items() if value is not None},
    )


def test_sound_weights_are_read_and_the_critic_is_left(folder):
    params = read_policy(folder, LIKE)["params"]
    np.testing.assert_array_equal(params["actor"]["kernel"], np.full((4, 3), 0.5))
    np.testing.assert_array_equal(params["critic"]["kernel"], LIKE["params"]["critic"]["kernel"])
    assert params["actor"]["bias"].dtype == np.float32


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


@pytest.mark.parametrize("kilobytes", [16, 700, 1800])
def test_a_state_for_which_the_disk_is_too_small_is_told(tmp_path, kilobytes, capfd):
    if (reason := why_no_disk()) is not None:
        pytest.skip(f"nothing can be mounted here: {reason}")
    state = {"weights": np.random.default_rng(0).random(100_000)}
    with small_disk(tmp_path / "disk") as resize:
        path = tmp_path / "disk" / "last"
        resize(kilobytes << 10)
        with pytest.raises(OSError, match=r"No space left on device.*last"):
            save_state(path, state, {"pool": "none"})
        assert not list(path.parent.iterdir())
        assert "Traceback" not in capfd.readouterr().err
        resize(10 << 20)
        save_state(path, state, {"pool": "none"})
        np.testing.assert_array_equal(read_state(path, state)["weights"], state["weights"])


def test_what_orbax_made_of_a_refusal_is_an_os_error_again(tmp_path, monkeypatch):
    class Refused:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            raise RuntimeError("Event loop is closed")

        def save(self, *_):
            raise ValueError("RESOURCE_EXHAUSTED: Failed writing [os_error_code='28']")

    monkeypatch.setattr(checkpoint, "_checkpointer", Refused)
    with pytest.raises(OSError, match="No space left") as caught:
        save_state(tmp_path / "last", {"x": np.ones(2)}, {})
    assert caught.value.errno == errno.ENOSPC
