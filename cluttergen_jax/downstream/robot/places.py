"""Where an object may be put: what placers propose, and where it then comes to rest."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from cluttergen_jax.downstream.placer.judge import Judge
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes
from cluttergen_jax.downstream.placer.proposers import FullState, proposals_of
from cluttergen_jax.numerics import new_key
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.types import Verdict


class SearchPlaces:
    """Places that a method of `generate` finds for the last object of scenes, knowing the others.

    The first is where the scene itself has it; then come proposals that stand, as attempts are judged, where
    they came to rest.

    Args:
      bank: whose scenes.
      method: "drop", "guided" or "policy".
      seed: of proposals.
      num_threads: simulation threads; 0 takes every core.

    Attributes:
      name: the method's.
    """

    def __init__(self, bank: Bank, method: str, seed: int, num_threads: int = 0) -> None:
        self.name = method
        self._scenes = PartialScenes(bank, num_threads)
        self._judge = Judge(self._scenes.rules)
        rules, propose = FullState(method).in_world(self._scenes.problem)
        self._propose: Any = jax.jit(lambda key, episode: proposals_of(propose, key, episode, rules).pose)
        self._key = new_key(seed)

    def __call__(self, index: int, scene: Scene) -> np.ndarray:
        """f64[M, 7]: T_world_object for the last object of a scene of the bank, best first."""
        row = int(np.flatnonzero(self._scenes.number == scene.origin.index)[0])
        slot = len(scene.names) - 1
        episodes = self._scenes.episodes(np.array([[row, slot]]))
        episode = jax.tree.map(lambda leaf: leaf[0], episodes)
        pose = np.asarray(self._propose(jax.random.fold_in(self._key, index), episode))
        judged = self._judge.settle(episodes, np.zeros(len(pose), np.int64), pose)
        focus = int(self._scenes.object_index[row, slot])
        stands = judged.poses[judged.verdict == int(Verdict.STABLE), focus]
        return np.concatenate([scene.poses[-1:], np.asarray(stands, np.float64)])
