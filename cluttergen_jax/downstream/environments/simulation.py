"""An episode in the model of a world: set-points of servos go in, and what the arm touches is watched."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from cluttergen_jax.assets import Box
from cluttergen_jax.downstream.environments.world import RobotWorld
from cluttergen_jax.downstream.robot.motion.collision import Kind
from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase
from cluttergen_jax.generation import WorldState
from cluttergen_jax.scene import Scene


class WorldExecution(Execution):
    """An `Execution` in a model that is compiled already.

    Args:
      world: the model. state: its beginning.
      scene: the objects that belong to it, by their names in the model; where they stand counts.
      target: the number of the object in it that the hand may touch at first.
    """

    def __init__(self, world: RobotWorld, state: WorldState, scene: Scene, target: int) -> None:
        self._world = world
        self._state = state
        super().__init__(scene, target, robot=world.description)

    def _compile(self, scene: Scene, stands: Sequence[Box]) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
        return self._world.spec, self._world.model

    def _start(self, scene: Scene) -> None:
        self._world.put(self.data, self._state)
        super()._start(scene)

    def advance(self, ctrl: np.ndarray, num_steps: int) -> None:
        """Brings the set-points evenly to f64[nu] in so many steps.

        The hand may touch the target, and that may touch anything.

        Raises:
          Failed: another contact of the arm pressed harder than `execute.MAX_FORCE`.
        """
        start = self.data.ctrl.copy()
        for step in range(1, num_steps + 1):
            self.data.ctrl[:] = start + (ctrl - start) * (step / num_steps)
            self._step(Phase.TOUCH)

    @property
    def is_touching(self) -> bool:
        """The arm or its hand touches the object that it may touch."""
        if not self.data.ncon:
            return False
        kinds = self._kind[self.data.contact.geom]
        is_arm = np.isin(kinds, (Kind.ARM, Kind.HAND)).any(1)
        return bool((is_arm & (kinds == Kind.TARGET).any(1)).any())

    def fork(self, num_steps: int) -> Recording:
        """A copy that goes on from here by itself; its set-points are kept every so many steps."""
        forked = copy.copy(self)
        forked.__class__ = Recording
        assert isinstance(forked, Recording)
        forked.data = copy.copy(self.data)
        forked.num_steps = 0
        forked.every = num_steps
        forked.commands = []
        return forked


class Recording(WorldExecution):
    """See `WorldExecution.fork`. every: steps; commands: f64[nu] each, the set-points every so many steps."""

    every: int
    commands: list[np.ndarray]

    def _step(self, phase: Phase) -> None:
        super()._step(phase)
        if self.num_steps % self.every == 0:
            self.commands.append(self.data.ctrl.copy())
