"""The folder that all trainings share: its recipe continues it, and a stopped run ends as a whole one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.training.run_folder import Interrupt, RunFolder, batch_of, hold_run
from tests.helpers.runs import Stopping

NUM_STEPS = 7
RECIPE = {"network": {"width": 8}, "seed": 0}


class State(struct.PyTreeNode):
    weights: jax.Array
    key: jax.Array
    step: jax.Array


def fresh() -> State:
    return State(jnp.zeros(2), jax.random.key(1), jnp.int32(0))


@jax.jit
def update(state: State, index: jax.Array) -> State:
    key = jax.random.fold_in(state.key, state.step)
    change = jax.random.normal(key, (2,)) + index
    return State(0.5 * state.weights + change, state.key, state.step + 1)


def learn(folder: RunFolder, interrupt: Interrupt) -> State:
    def step(number, state):
        return update(state, batch_of(number, 2, 6, 0)), f"step {number}"

    return folder.learn(folder.load(fresh()), NUM_STEPS, step, interrupt)


def test_a_stopped_run_ends_as_one_that_was_not(tmp_path):
    whole = learn(RunFolder(tmp_path / "whole", RECIPE), Stopping(100))
    stopped = learn(RunFolder(tmp_path / "parts", RECIPE), Stopping(3))
    assert int(stopped.step) == 3
    again = RunFolder(tmp_path / "parts", RECIPE)
    assert int(again.load(fresh()).step) == 3
    ended = learn(again, Stopping(100))
    assert int(ended.step) == int(whole.step) == NUM_STEPS
    np.testing.assert_array_equal(ended.weights, whole.weights)
    assert learn(again, Stopping(100)).weights.tolist() == whole.weights.tolist()


def test_another_recipe_and_what_is_no_run_are_refused(tmp_path):
    run = RunFolder(tmp_path / "run", RECIPE)
    assert not run.is_begun
    assert run.record("last") == {}
    run.save(fresh(), num_updates=4)
    assert RunFolder(tmp_path / "run", RECIPE).record("last")["num_updates"] == 4
    with pytest.raises(ConfigError, match=r"another network.width \(8 there, 16 asked for\)"):
        RunFolder(tmp_path / "run", RECIPE | {"network": {"width": 16}})
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.jpg").touch()
    with pytest.raises(ConfigError, match="belongs to no run"):
        RunFolder(tmp_path / "photos", RECIPE)
    with pytest.raises(ConfigError, match="belongs to no run"), hold_run(tmp_path / "photos"):
        pass


def test_each_epoch_sees_every_example_once_in_an_order_of_its_own():
    epochs = [
        np.concatenate([batch_of(3 * epoch + number, 2, 6, 5) for number in range(3)])
        for epoch in range(2)
    ]
    for order in epochs:
        assert sorted(order) == list(range(6))
    assert epochs[0].tolist() != epochs[1].tolist()
    assert all(len(batch_of(number, 4, 10, 0)) == 4 for number in range(4))
