"""A Gymnasium vector environment as Stable-Baselines3 wants it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from cluttergen_jax.generation.gymnasium_envs import GymnasiumVectorEnv, Info


class SB3VecEnv(VecEnv):
    """`VecEnv` over a `GymnasiumVectorEnv`; see `make_sb3_env`.

    `infos[i]` has "verdict", "num_placed" and "is_success" of each attempt; at an episode's end also
    "terminal_observation" and "episode", its sum of rewards "r" and its attempts "l".
    """

    def __init__(self, envs: GymnasiumVectorEnv) -> None:
        self.envs = envs
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._reward = np.zeros(envs.num_envs)
        self._length = np.zeros(envs.num_envs, int)

    def reset(self) -> Any:
        """New episodes; with the seed of `seed`, if it was called."""
        obs, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reward[:] = 0
        self._length[:] = 0
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of `step_wait`, f32[N, 4]."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[Info]]:
        """One attempt of each scene."""
        obs, reward, is_over, _, infos = self.envs.step(self._actions)
        self._reward += reward
        self._length += 1
        return obs, reward, is_over, [self._info(infos, index) for index in range(self.num_envs)]

    def _info(self, infos: Info, index: int) -> Info:
        names = ("verdict", "num_placed", "is_success")
        if not infos.get("_final_info", np.zeros(self.num_envs, bool))[index]:
            return {name: infos[name][index].item() for name in names}
        info = {name: infos["final_info"][name][index].item() for name in names}
        info["terminal_observation"] = infos["final_obs"][index]
        info["episode"] = {"r": float(self._reward[index]), "l": int(self._length[index])}
        self._reward[index] = 0
        self._length[index] = 0
        return info

    def close(self) -> None:
        """Closes the environment beneath."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environment beneath, which all scenes share."""
        return [getattr(self.envs, attr_name)] * self._num_of(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets it for all scenes."""
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *arguments: Any, indices: Any = None, **named: Any
    ) -> list[Any]:
        """Calls a method of the environment beneath once."""
        return [getattr(self.envs, method_name)(*arguments, **named)] * self._num_of(indices)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No scene is: all are one environment."""
        return [False] * self._num_of(indices)

    def _num_of(self, indices: int | Sequence[int] | None) -> int:
        return len(list(self._get_indices(indices)))
