"""How episodes begin: as a scene and its goals, and as numbers and names that can be kept."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cluttergen_jax.downstream.episodes.world import SimulatedWorld
from cluttergen_jax.errors import BankError, ConfigError


@dataclass(frozen=True, eq=False)
class EpisodeStart:
    """How an episode begins.

    Attributes:
      scene: objects where they stand (`SimulatedWorld.scene`).
      target: the number of the one that is to be moved (first).
      goals: f64[N, 7], T_world_object where they shall go; of the target alone one that is known to do.
    """

    scene: Any
    target: int
    goals: np.ndarray


@dataclass(frozen=True, eq=False)
class SavedStart:
    """How an episode began, so that it can begin again.

    Attributes:
      scene: its number in the bank. seed: of what was randomized.
      target: the name of the object that is to be moved (first).
      names: of the scene's N objects. poses: f64[N, 7], T_world_object, where they began.
      goals: f64[N, 7], as `EpisodeStart.goals`.
      words: the task in words.
    """

    scene: int
    seed: int
    target: str
    names: tuple[str, ...]
    poses: np.ndarray
    goals: np.ndarray
    words: str

    def text(self) -> str:
        """As JSON; floats come back as they were."""
        arrays = {"poses": self.poses.tolist(), "goals": self.goals.tolist()}
        return json.dumps({**self.__dict__, "names": list(self.names), **arrays})

    @staticmethod
    def of_text(text: str) -> SavedStart:
        """What `text` wrote (LookupError, TypeError or ValueError: it did not)."""
        found = json.loads(text)
        arrays = {name: np.array(found[name], np.float64) for name in ("poses", "goals")}
        names = tuple(found["names"])
        start = SavedStart(**{**found, "names": names, **arrays})
        if any(each.shape != (len(names), 7) for each in arrays.values()) or (
            start.target not in names
        ):
            raise ValueError("a start whose poses are not those of its objects")
        return start

    def of(self, world: SimulatedWorld) -> tuple[Any, EpisodeStart]:
        """The same in a world. Raises BankError: its bank has another scene there."""
        try:
            state = world.reset(self.seed, index=self.scene)
        except ConfigError as error:
            raise _other_scene(self) from error
        scene = world.scene(state)
        if sorted(scene.names) != sorted(self.names):
            raise _other_scene(self)
        order = [self.names.index(name) for name in scene.names]
        placed = replace(scene, poses=self.poses[order])
        # To the last bit: a quaternion of unit length that is divided by its own changes in that.
        placed.poses[:] = self.poses[order]
        target = scene.names.index(self.target)
        return state, EpisodeStart(placed, target, self.goals[order].copy())


def _other_scene(start: SavedStart) -> BankError:
    return BankError(
        f"an episode that began in scene {start.scene} of {', '.join(start.names)}",
        "the bank that it was recorded in",
        "make_env(recording=..., bank=FOLDER)",
    )
