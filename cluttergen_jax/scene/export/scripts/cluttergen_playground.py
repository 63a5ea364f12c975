"""A bank of scenes in MuJoCo Playground: a robot takes an object out of clutter, or puts one into it.

    import cluttergen_playground as clutter       # needs playground 0.2 and this package, extra `robot`

    clutter.register("ClutterPick", "bank")                    # register("ClutterPlace", task="place")
    env = mujoco_playground.registry.load("ClutterPick")
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 1024))

The environment is `cluttergen_jax.make_mjx_env`: other objects in each world, and its judge: an episode is a
success only where the other objects have stayed. Trainers wrap it by
`wrapper.wrap_for_brax_training(env, env.episode_length, full_reset=True)`: another scene for each episode.
`brax_ppo_config()` are settings of Brax's PPO; `registry.get_domain_randomizer` finds `domain_randomize`.

With a robot of your own, or another reward, extend the class:

    class MyPick(clutter.ClutterEnv):
        robot = "my_arm.yaml"                                  # docs/guide/robots.md

        def reward(self, before, after, action):
            return after.reward - 0.01 * jnp.square(action).sum()

    clutter.register("MyPick", "bank", env_class=MyPick)
"""

# ruff: noqa: E402
from functools import partial
from pathlib import Path

from host_checks import check_versions

KNOWN = {"playground": ("0.2.",), "mujoco": ("3.17.",), "mujoco-mjx": ("3.17.",)}
"""How the versions begin that this was run with."""
check_versions(
    KNOWN,
    "playground==0.2.0 '.[robot]' in a checkout of cluttergen_jax",
    ("mujoco_playground", "cluttergen_jax"),
)

import jax
import mujoco
import numpy as np
from ml_collections import config_dict
from mujoco_playground import manipulation, registry
from mujoco_playground._src import mjx_env

import cluttergen_jax as cg

_registered: set[str] = set()
"""Names that `register` was given."""
_SECONDS = {"grasp": 15.0, "place": 40.0}
_WATCHED = 2.0
"""Seconds for which an object that was let go is watched."""


def default_config(task="grasp"):
    """The configuration; `impl`, `num_envs` and `reward` are those of `make_mjx_env`."""
    _check_task(task)
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


def brax_ppo_config(task="grasp"):
    """Settings of Brax's PPO, in the fields of Playground's own; a start, with which no policy was trained.

    With a JAX that is too new for Brax: `cg.envs.train_brax(env, wrap_env_fn=..., **settings)`.
    """
    config = default_config(task)
    return config_dict.create(
        num_timesteps=50_000_000,
        num_evals=10,
        num_resets_per_eval=1,
        episode_length=config.episode_length,
        action_repeat=config.action_repeat,
        normalize_observations=True,
        reward_scaling=1.0,
        num_envs=config.num_envs,
        num_eval_envs=128,
        unroll_length=20,
        batch_size=512,
        num_minibatches=32,
        num_updates_per_batch=8,
        discounting=0.98,
        learning_rate=5e-4,
        entropy_cost=1e-2,
        max_grad_norm=1.0,
        network_factory=config_dict.create(
            policy_hidden_layer_sizes=(256, 256, 256),
            value_hidden_layer_sizes=(256, 256, 256, 256, 256),
            policy_obs_key="state",
            value_obs_key="state",
        ),
    )


def domain_randomize(model, rng):
    """Another friction, and another mass for each object, in each world; ranges of `RandomizationConfig`.

    Args:
      model: the `mjx.Model`. rng: W keys, one for each world.

    Returns:
      The model with W rows in the fields that differ, and the axes of its fields for `jax.vmap`.
    """
    ranges = cg.robot.RandomizationConfig()
    free = np.flatnonzero(np.asarray(model.jnt_type) == mujoco.mjtJoint.mjJNT_FREE)
    bodies = np.asarray(model.jnt_bodyid)[free]
    dofs = np.asarray(model.jnt_dofadr)[free][:, None] + np.arange(6)

    @jax.vmap
    def draw(key):
        mass_key, friction_key = jax.random.split(key)
        friction = jax.random.uniform(
            friction_key, (), minval=ranges.friction[0], maxval=ranges.friction[1]
        )
        mass = jax.random.uniform(
            mass_key, (len(bodies),), minval=ranges.mass[0], maxval=ranges.mass[1]
        )
        # A free body's inertia grows as its mass, and its inverse weight shrinks so.
        return {
            "geom_friction": model.geom_friction * friction,
            "body_mass": model.body_mass.at[bodies].multiply(mass),
            "body_subtreemass": model.body_subtreemass.at[bodies].multiply(mass),
            "body_inertia": model.body_inertia.at[bodies].multiply(mass[:, None]),
            "body_invweight0": model.body_invweight0.at[bodies].divide(mass[:, None]),
            "dof_invweight0": model.dof_invweight0.at[dofs].divide(mass[:, None]),
            "dof_M0": model.dof_M0.at[dofs].multiply(mass[:, None]),
        }

    fields = draw(rng)
    axes = jax.tree.map(lambda _: None, model).tree_replace(dict.fromkeys(fields, 0))
    return model.tree_replace(fields), axes


class ClutterEnv(mjx_env.MjxEnv):
    """A robot in the scenes of a bank. Extend it: `robot`, `observe` and `reward`.

    Args:
      config: of `default_config`. config_overrides: of its fields.
      bank: the folder of the scenes; this file's own, or its `bank`, if not given.
      task: "grasp" or "place".

    Attributes:
      robot: a name, the path of a YAML file, or a `cg.robot.RobotDescription`; the configuration's if None.
      episode_length: steps of control of the longest episode.
    """

    robot = None

    def __init__(self, config=None, config_overrides=None, bank=None, task="grasp"):
        super().__init__(config or default_config(task), config_overrides)
        config = self._config
        folder = Path(__file__).resolve().parent
        usual = default_config(task)
        if config.sim_dt != usual.sim_dt or config.action_repeat != usual.action_repeat:
            raise ValueError("sim_dt is 1/480 and action_repeat 1; ctrl_dt may be changed")
        watched = _WATCHED if task == "place" else 0.0
        self._env = cg.make_mjx_env(
            Path(bank or (folder / "bank" if (folder / "bank").is_dir() else folder)),
            config.robot if self.robot is None else self.robot,
            task,
            impl=config.impl,
            num_envs=config.num_envs,
            reward=config.reward,
            control_hz=1 / config.ctrl_dt,
            max_seconds=config.episode_length * config.ctrl_dt - watched,
        )
        self._ctrl_dt = self._env.dt
        self._sim_dt = self._env.sim_dt
        self.episode_length = self._env.episode_length

    def reset(self, rng):
        """The beginning of an episode in a scene that is drawn."""
        state = self._env.reset(rng)
        return state.replace(obs=self.observe(state))

    def step(self, state, action):
        """A step of control; actions from -1 to 1."""
        after = self._env.step(state, action)
        reward = self.reward(state, after, action)
        return after.replace(obs=self.observe(after), reward=reward)

    def observe(self, state):
        """f32[D]: what is observed; `agent_pos`, then `environment_state` of `make_robot_env`."""
        return state.obs

    def reward(self, before, after, action):
        """f32: the reward of a step; that of `make_mjx_env` is `after.reward`."""
        return after.reward

    @property
    def world(self):
        """The model with its names and resets: `world.names`, `world.object_qpos`."""
        return self._env.world

    @property
    def _mjx_model(self):
        # Playground's wrapper of domain randomization puts a model with rows for all worlds here.
        return self._env._mjx_model

    @_mjx_model.setter
    def _mjx_model(self, model):
        self._env._mjx_model = model

    @property
    def action_size(self):
        """Joints of the arm, and 1 for the gripper."""
        return self._env.action_size

    @property
    def mj_model(self):
        """Of C MuJoCo."""
        return self._env.mj_model

    @property
    def mjx_model(self):
        """On the device."""
        return self._env.mjx_model

    @property
    def xml_path(self):
        """The bank that the model is made of."""
        return self._env.xml_path


def register(name="ClutterPick", bank=None, task="grasp", env_class=ClutterEnv):
    """Registers an environment: `registry.load(name)`; it is in `registry.ALL_ENVS`, with a randomizer.

    Args:
      bank: the folder of the scenes; this file's own, or its `bank`, if not given.
      task: "grasp" or "place".
      env_class: `ClutterEnv`, or your own that extends it.

    Raises:
      ValueError: there is no such task, or somebody else registered that name; one's own is replaced.
    """
    _check_task(task)
    if name in (*registry.ALL_ENVS, *manipulation.ALL_ENVS) and name not in _registered:
        raise ValueError(f"name = {name!r}, which Playground has. Try: another name")
    load = partial(env_class, bank=bank, task=task)
    manipulation.register_environment(name, load, partial(default_config, task))
    # Playground has no function for these two.
    manipulation._randomizer[name] = domain_randomize
    _registered.add(name)
    if name not in registry.ALL_ENVS:
        registry.ALL_ENVS = (*registry.ALL_ENVS, name)


def _check_task(task):
    if task not in _SECONDS:
        raise ValueError(f"task = {task!r}. Allowed: {', '.join(_SECONDS)}")
