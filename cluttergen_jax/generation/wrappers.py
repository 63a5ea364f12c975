"""What general trainers want of an environment: a vector to look at, and few numbers of a usual range."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.numerics import as_float32, new_key, with_own_settings
from cluttergen_jax.placement.brax_env import Env, State, Wrapper
from cluttergen_jax.placement.env import PlacementEnv
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search import CLEARANCE
from cluttergen_jax.types import Array


class FlatObservation(Wrapper):
    """A `PlacementEnv` whose observation is one vector, f32[D].

    In this order, for K objects of the world, A attempts, H rows kept of each and G x G cells, everything as
    in `placement.observation.observe` and raveled (the last axis runs fastest):

        region                3    half extents and height range, metres
        focus                 K    1 for the current object, else 0
        is_placed             K    1 or 0
        T_region_object       7 K  positions in metres, quaternions wxyz; zero where not placed
        history: is_tried     A    1 or 0; the rows that follow are zero where it is 0
                 action       4 A  in (0, 1)
                 region       3 A  metres
                 num_steps    A    as a share of the most steps
                 trajectory   13 A H
        heights               G G  metres

    Raises:
      ConfigError: the environment is asked for point clouds, which are no part of the vector.
    """

    def __init__(self, env: PlacementEnv) -> None:
        super().__init__(env)
        if env.observation.num_scene_points:
            raise ConfigError(
                f"{env.observation.num_scene_points} scene points in a flat observation",
                "no point clouds",
                'observation="dict", or heights (num_cells) in place of clouds',
            )

    @with_own_settings
    def reset(self, rng: Array) -> State:
        """See `PlacementEnv.reset`."""
        return self._flat(self.env.reset(rng))

    @with_own_settings
    def step(self, state: State, action: Array) -> State:
        """See `PlacementEnv.step`."""
        return self._flat(self.env.step(state, action))

    def _flat(self, state: State) -> State:
        seen: Any = state.obs
        rules = self.env.rules
        history = seen["history"]
        parts = [
            seen["region"],
            jax.nn.one_hot(seen["focus"], rules.geometry.num_objects),
            seen["is_placed"],
            seen["T_region_object"],
            history["is_tried"],
            history["action"],
            history["region"],
            history["num_steps"] / rules.physics.config.last_step,
            history["trajectory"],
            seen.get("heights", jnp.zeros(0)),
        ]
        return state.replace(
            obs=jnp.concatenate([part.astype(jnp.float32).reshape(-1) for part in parts])
        )

    @property
    def observation_size(self) -> int:
        """D."""
        return jax.eval_shape(self.reset, new_key(0)).obs.shape[0]


class OnSurface(Wrapper):
    """An environment whose actions are three numbers in (0, 1): x, y and turn.

    The height is left to geometry: the object is let go just above the support, as `random` and `clear` do.
    Nothing can be put onto or into another object by intent.

    Args:
      env: whose actions have four numbers.
      rules: those of `env`.
    """

    def __init__(self, env: Env, rules: Rules) -> None:
        super().__init__(env)
        self.rules = rules

    @with_own_settings
    def step(self, state: State, action: Array) -> State:
        """One attempt with `action`, f32[3]."""
        rules = self.rules
        episode = state.pipeline_state.episode
        height = rules.geometry.half_extents[rules.focus(episode), 2] + CLEARANCE
        z = jnp.minimum(height / rules.height_range(episode), 1.0)
        return self.env.step(state, jnp.stack([action[0], action[1], z, action[2]]))

    @property
    def action_size(self) -> int:
        """x, y and turn."""
        return 3


class ActionRange(Wrapper):
    """An environment whose actions run from `low` to `high` in place of 0 to 1; what is beyond is clipped.

    Brax's own policies and most others are made for -1 to 1.
    """

    def __init__(self, env: Any, low: float, high: float) -> None:
        super().__init__(env)
        if not low < high:
            raise ConfigError(
                f"action_range = ({low}, {high})", "two numbers that rise", "(-1.0, 1.0)"
            )
        self.low = float(low)
        self.high = float(high)

    @with_own_settings
    def step(self, state: State, action: Array) -> State:
        """See `PlacementEnv.step`."""
        action = as_float32(action)
        return self.env.step(
            state, jnp.clip((action - self.low) / (self.high - self.low), 0.0, 1.0)
        )

    def propose(self, key: Array, state: State) -> Array:
        """See `PlacementEnv.propose`."""
        return self.low + (self.high - self.low) * self.env.propose(key, state)
