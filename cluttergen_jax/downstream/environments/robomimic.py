"""The environment of a recording as robomimic makes it from `demo.hdf5`: by its wrapper of Gym.

`env_args` of that file name this module, and `gym.make` imports what stands before the colon of a name. That
wrapper wants what Gym gave once: one row of numbers (`obs/flat`: `agent_pos`, then `environment_state`), four
values of a step, and a simulation whose state can be read and set.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gym
import numpy as np

from cluttergen_jax.downstream.environments.api import make_robot_env
from cluttergen_jax.downstream.environments.recordings import Recording, check_environment
from cluttergen_jax.downstream.robot.recorder import GYM_NAME


class ClutterRobot(gym.Env):
    """See the module.

    Args:
      environment: what a recording says of its environment.
      bank: where the bank is, if no longer where it was.
      lang: a task in words, which robomimic passes on, and which is not used.

    Attributes:
      env: the environment itself. sim: its simulation, as old bindings of MuJoCo looked.
    """

    def __init__(
        self, environment: Mapping[str, Any], bank: str | None = None, lang: str | None = None
    ) -> None:
        place = Path("env_args")
        told = check_environment(dict(environment), place)
        recording = Recording(place, "robomimic", told, (), ())
        where = recording.bank if bank is None else bank
        self.env = make_robot_env(recording=recording, bank=where)
        # robomimic's wrapper passes no pictures on.
        self.env.is_drawing = False
        self.sim = _Simulation(self)
        actions = self.env.action_space
        self.action_space = gym.spaces.Box(-1.0, 1.0, actions.shape, np.float32)
        seen = self.env.observation_space
        number = sum(seen[name].shape[0] for name in ("agent_pos", "environment_state"))
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (number,), np.float32)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> np.ndarray:
        """A new episode; f32[D], what is observed."""
        seen, info = self.env.reset(seed=seed, options=options)
        return self._keep_seen(seen, info)

    def _keep_seen(self, seen: Mapping[str, Any], info: Mapping[str, Any]) -> np.ndarray:
        self._seen = np.concatenate([seen["agent_pos"], seen["environment_state"]])
        self._is_success = bool(info["is_success"])
        if self.env.execution is not None:
            self.state = self.env.simulation_state
        return self._seen

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        """What is observed, the reward, whether the episode is over, and `info` of the environment."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        return self._keep_seen(seen, info), reward, terminated or truncated, info

    def render(self, mode: str = "rgb_array", **size: Any) -> np.ndarray:
        """u8[height, width, 3], of the environment's own size."""
        picture = self.env.render()
        assert picture is not None
        return picture

    def close(self) -> None:
        """Frees what pictures are drawn with."""
        self.env.close()

    def _get_obs(self) -> np.ndarray:
        return self._seen

    def _check_success(self) -> dict[str, bool]:
        return {"task": self._is_success}


class _Simulation:
    """The state of an environment (`RobotEnv.simulation_state`), read and set as robomimic does."""

    def __init__(self, env: ClutterRobot) -> None:
        self._env = env
        self.model = self

    def get_xml(self) -> str:
        """Nothing: the environment is made by its description."""
        return ""

    def get_state(self) -> np.ndarray:
        """f64[D]; after the last step that before it."""
        return self._env.state

    def set_state_from_flattened(self, state: np.ndarray) -> None:
        """Goes on from f64[D]."""
        self._env._keep_seen(*self._env.env.set_simulation_state(state))

    def forward(self) -> None:
        """It is done as the state is set."""


gym.register(
    id=GYM_NAME.partition(":")[2],
    entry_point=f"{__name__}:{ClutterRobot.__name__}",
    disable_env_checker=True,
    order_enforce=False,
)
