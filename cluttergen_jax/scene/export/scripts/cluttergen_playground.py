"""A bank of scenes in MuJoCo Playground: a robot takes an object out of clutter, or puts one into it.

    import cluttergen_playground as clutter       # needs playground 0.2 and cluttergen_jax[robot]

    clutter.register("ClutterPick", "bank")                    # register("ClutterPlace", task="place")
    env = mujoco_playground.registry.load("ClutterPick")
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 1024))

The environment is `cluttergen_jax.make_mjx_env`: other objects in each world, and its judge. Trainers wrap it
by `wrapper.wrap_for_brax_training(env, env.episode_length, full_reset=True)`: another scene for each episode.
"""

from functools import partial
from pathlib import Path

from ml_collections import config_dict
from mujoco_playground import manipulation

import cluttergen_jax as cg

_SECONDS = {"grasp": 15.0, "place": 40.0}
_WATCHED = 2.0
"""Seconds for which an object that was let go is watched."""


def default_config(task="grasp"):
    """The configuration; `impl`, `num_envs` and `reward` are those of `make_mjx_env`."""
    ctrl_dt = 0.05
    watched = _WATCHED if task == "place" else 0.0
    return config_dict.create(
        robot="panda",
        ctrl_dt=ctrl_dt,
        sim_dt=1 / 480,
        episode_length=round((_SECONDS[task] + watched) / ctrl_dt),
        action_repeat=1,
        impl="warp",
        num_envs=2048,
        reward="dense",
    )


def register(name="ClutterPick", bank=None, task="grasp"):
    """Registers an environment: `registry.load(name)`.

    Args:
      bank: the folder of the scenes; this file's own, or its `bank`, if not given.
      task: "grasp" or "place".
    """
    load = partial(_load, bank=bank, task=task)
    manipulation.register_environment(name, load, partial(default_config, task))


def _load(config=None, config_overrides=None, bank=None, task="grasp"):
    config = config or default_config(task)
    config.update_from_flattened_dict(config_overrides or {})
    folder = Path(__file__).resolve().parent
    bank = Path(bank or (folder / "bank" if (folder / "bank").is_dir() else folder))
    usual = default_config(task)
    if config.sim_dt != usual.sim_dt or config.action_repeat != usual.action_repeat:
        raise ValueError("sim_dt is 1/480 and action_repeat 1; ctrl_dt may be changed")
    watched = _WATCHED if task == "place" else 0.0
    return cg.make_mjx_env(
        bank,
        config.robot,
        task,
        impl=config.impl,
        num_envs=config.num_envs,
        reward=config.reward,
        control_hz=1 / config.ctrl_dt,
        max_seconds=config.episode_length * config.ctrl_dt - watched,
    )
