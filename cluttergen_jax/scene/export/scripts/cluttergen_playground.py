"""A bank of scenes in MuJoCo Playground: a Panda lifts one object out of a scene; the bank is the reset.

    import cluttergen_playground as clutter       # beside bank_reader.py; needs playground 0.2 and pyarrow

    clutter.register("ClutterPick", "bank")
    env = mujoco_playground.registry.load("ClutterPick")
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 1024))

All objects of the bank are in the model; those that a scene lacks wait far away, held by a force. Warp, the
default, needs an NVIDIA GPU; `config_overrides={"impl": "jax"}` is for a few simple objects.
"""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jp
import mujoco
import numpy as np
from bank_reader import Bank
from ml_collections import config_dict
from mujoco import mjx
from mujoco_playground import manipulation
from mujoco_playground._src import mjx_env

_HOME = (0.0, 0.3, 0.0, -1.57079, 0.0, 2.0, -0.7853, 0.04, 0.04)
_ROBOT_DISTANCE = 0.525
"""Metres from the region's centre to the arm's base, in -x."""
_BESIDE = 0.225
"""Metres from the region's edge to the arm's base, at least."""
_FALL = 0.25
"""Metres below where an object began: what has fallen as deep, or half of the support's height, is lost."""
_SCALES = {"reach": 1.0, "lift": 4.0, "others_still": 1.0, "home": 0.1}


def default_config():
    """The configuration; `sim_dt` is what files of banks have unless another setting is asked for."""
    return config_dict.create(
        ctrl_dt=10 / 480,
        sim_dt=1 / 480,
        episode_length=240,
        action_repeat=1,
        action_scale=0.04,
        lift_height=0.1,
        reward_config=config_dict.create(scales=config_dict.create(**_SCALES)),
        impl="warp",
        naconmax=256 * 2048,
        naccdmax=256 * 2048,
        njmax=1024,
    )


def register(name="ClutterPick", bank=None):
    """Registers the environment under a name: `registry.load(name)`."""
    manipulation.register_environment(name, partial(ClutterPick, bank=bank), default_config)


class ClutterPick(mjx_env.MjxEnv):
    """Lift the target, drawn among the scene's objects, and leave the others where they stand.

    Observations: the arm's qpos and qvel, the gripper's pose, the target's pose from there, where all objects
    are from there, whether they are in the scene, and which is the target. Actions: changes of the controls.

    Args:
      bank: the folder of the scenes; this file's own, or its `bank`, if not given.
    """

    def __init__(self, config=None, config_overrides=None, bank=None):
        super().__init__(config or default_config(), config_overrides)
        folder = Path(__file__).resolve().parent
        self._bank = Bank(bank or (folder / "bank" if (folder / "bank").is_dir() else folder))
        self._scenes = jax.tree.map(jp.asarray, self._bank.arrays)
        spec = mujoco.MjSpec.from_string(self._bank.xml())
        region = self._bank.region
        top = self._bank.support.record["top"]
        # Beyond the region, however large and turned it is.
        half = np.abs([np.cos(region["yaw"]), np.sin(region["yaw"])]) @ region["half_extents"]
        base = [
            region["center"][0] - max(_ROBOT_DISTANCE, half + _BESIDE),
            region["center"][1],
            top,
        ]
        panda = mujoco.MjSpec.from_file(
            (mjx_env.MENAGERIE_PATH / "franka_emika_panda" / "mjx_panda.xml").as_posix()
        )
        spec.attach(panda, prefix="", frame=spec.worldbody.add_frame(pos=base))
        for key in list(spec.keys):
            spec.delete(key)
        self._mj_model = spec.compile()
        self._mj_model.opt.timestep = self.sim_dt
        self._mjx_model = mjx.put_model(self._mj_model, impl=self._config.impl)
        model = self._mj_model
        self._num_objects = (model.nq - len(_HOME)) // 7
        self._objects = np.arange(2, 2 + self._num_objects)
        assert [
            model.jnt_bodyid[each] for each in range(self._num_objects)
        ] == self._objects.tolist()
        self._gripper = model.site("gripper").id
        self._lowers, self._uppers = model.actuator_ctrlrange.T
        self._ctrl = jp.asarray(_HOME[: model.nu])
        # Where nothing is below the support, there is a floor.
        self._deepest_fall = min(_FALL, top / 2)

    def reset(self, rng):
        rng, scene_key, target_key = jax.random.split(rng, 3)
        scene = self._scenes.reset(scene_key)
        poses, held = self._bank.state(scene)
        is_there = (held[:, 2] == 0).astype(float)
        target = jax.random.categorical(target_key, jp.log(is_there))
        data = mjx_env.make_data(
            self._mj_model,
            qpos=jp.concatenate([poses, jp.asarray(_HOME)]),
            qvel=jp.zeros(self._mj_model.nv),
            ctrl=self._ctrl,
            impl=self._mjx_model.impl.value,
            naconmax=self._config.naconmax,
            naccdmax=self._config.naccdmax,
            njmax=self._config.njmax,
        )
        data = data.replace(xfrc_applied=data.xfrc_applied.at[self._objects].set(held))
        info = {
            "rng": rng,
            "scene": scene.index,
            "target": target,
            "is_there": is_there,
            "start": poses.reshape(-1, 7)[:, :3],
        }
        data = mjx.forward(self._mjx_model, data)
        metrics = {"success": jp.zeros(()), **{name: jp.zeros(()) for name in _SCALES}}
        return mjx_env.State(
            data, self._observation(data, info), jp.zeros(()), jp.zeros(()), metrics, info
        )

    def step(self, state, action):
        ctrl = jp.clip(
            state.data.ctrl + action * self._config.action_scale, self._lowers, self._uppers
        )
        data = mjx_env.step(self._mjx_model, state.data, ctrl, self.n_substeps)
        info = state.info
        places = data.xpos[self._objects]
        shift = jp.linalg.norm(places - info["start"], axis=-1) * info["is_there"]
        is_target = jp.arange(self._num_objects) == info["target"]
        height = (places - info["start"])[info["target"], 2]
        reach = jp.linalg.norm(places[info["target"]] - data.site_xpos[self._gripper])
        home = jp.linalg.norm(data.qpos[-len(_HOME) : -2] - jp.asarray(_HOME[:-2]))
        terms = {
            "reach": 1 - jp.tanh(5 * reach),
            "lift": jp.clip(height / self._config.lift_height, 0, 1),
            "others_still": 1 - jp.tanh(20 * jp.max(jp.where(is_target, 0, shift))),
            "home": 1 - jp.tanh(home),
        }
        reward = sum(
            scale * terms[name] for name, scale in self._config.reward_config.scales.items()
        )
        fall = (info["start"] - places)[:, 2] * info["is_there"]
        is_lost = (fall > self._deepest_fall).any() | jp.isnan(data.qpos).any()
        metrics = {"success": (height >= self._config.lift_height).astype(float), **terms}
        obs = self._observation(data, info)
        return state.replace(
            data=data,
            obs=obs,
            reward=reward,
            done=is_lost.astype(float),
            metrics=metrics,
            info=info,
        )

    def _observation(self, data, info):
        arm = slice(-len(_HOME), None)
        position = data.site_xpos[self._gripper]
        turn = data.site_xmat[self._gripper].reshape(3, 3)
        body = jp.asarray(self._objects)[info["target"]]
        seen = (data.xpos[self._objects] - position) * info["is_there"][:, None]
        return jp.concatenate(
            [
                data.qpos[arm],
                data.qvel[arm],
                position,
                turn.ravel(),
                (data.xpos[body] - position) @ turn,
                (turn.T @ data.xmat[body].reshape(3, 3)).ravel(),
                seen.ravel(),
                info["is_there"],
                jax.nn.one_hot(info["target"], self._num_objects),
            ]
        )

    @property
    def xml_path(self):
        return str(self._bank.path / "bank.json")

    @property
    def action_size(self):
        return self._mjx_model.nu

    @property
    def mj_model(self):
        return self._mj_model

    @property
    def mjx_model(self):
        return self._mjx_model
