"""Training runs small enough for tests: made-up physics and a tiny network."""

from __future__ import annotations

from dataclasses import asdict

import jax
import numpy as np

from cluttergen_jax.learning.networks.config import NetworkConfig
from cluttergen_jax.learning.ppo.ppo import PPOConfig
from cluttergen_jax.learning.training.run import Run, RunConfig
from cluttergen_jax.learning.training.run_folder import Interrupt, RunFolder
from tests.helpers.problems import made_up_rules

SMALL = NetworkConfig(
    object_points=8,
    object_features=8,
    token_width=16,
    num_heads=2,
    history_width=8,
    num_layers=2,
    width=16,
)
PPO = PPOConfig(num_envs=4, num_steps=4, num_minibatches=2, num_epochs=2, num_attempts=64)


def recipe(rules):
    """What is stored with its policies."""
    return {"kind": "pose", "placement": asdict(rules.config), "network": asdict(SMALL)}


def make_run(folder, ppo=PPO, seed=0, evaluate=None, **config):
    """A run of four updates, two a call at most."""
    rules = made_up_rules(history_stride=12, reward="compressed")
    watched = RunConfig(**{"seed": seed, "window": 2} | config)
    return Run(rules, SMALL, ppo, watched, RunFolder(folder, recipe(rules)), evaluate)


class Stopping(Interrupt):
    """As if Ctrl-C were pressed while the given number of calls had been made."""

    def __init__(self, calls):
        super().__init__()
        self.calls = calls

    @property
    def is_asked(self):
        self.calls -= 1
        return self.calls < 0

    @is_asked.setter
    def is_asked(self, value): ...

    def run_compiling(self, function, *args):
        """Does not count as a call."""
        return function(*args)


def weights(state) -> np.ndarray:
    """All weights of a state, f32[W]."""
    return np.concatenate([np.asarray(leaf).ravel() for leaf in jax.tree.leaves(state.params)])
