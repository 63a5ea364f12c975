"""A bank of scenes as a LeRobot EnvHub environment: a gripper lifts a named object out of the clutter.

    envs = lerobot.envs.make_env("OWNER/REPOSITORY", n_envs=4, trust_remote_code=True)

This file, `bank_reader.py` and `bank/` are the repository; it needs mujoco, pyarrow and gymnasium. The
gripper moves along x, y and z and turns about z. Actions: four speeds and, above 0, open, all in [-1, 1].
"""

import os
import sys
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np

_FOLDER = Path(__file__).absolute().parent
# Steps of an episode, and per second.
_STEPS = 300
_CONTROL = 20

_SPEED = np.array([0.25, 0.25, 0.25, 1.5])
"""Metres and radians per second."""
# Metres from the middle to an open finger, above the top at the start, and to lift; height and width.
_OPEN = 0.05
_START = 0.3
_LIFT = 0.1
_PIXELS = (240, 320)

_CLEAR = 0.03
"""Metres between the highest object and the fingers at the start."""
_GRIPPER = """<mujoco><compiler angle="radian"/><worldbody><body name="gripper" gravcomp="1">
<joint name="x" type="slide" axis="1 0 0" armature="1"/>
<joint name="y" type="slide" axis="0 1 0" armature="1"/>
<joint name="z" type="slide" axis="0 0 1" armature="1"/><joint name="yaw" axis="0 0 1" armature="0.05"/>
<geom type="box" size="0.02 0.07 0.015" pos="0 0 0.09" mass="0.5" rgba="0.3 0.3 0.32 1"/>
<geom type="cylinder" size="0.012 0.15" pos="0 0 0.25" mass="0.1" rgba="0.6 0.6 0.62 1" contype="0"
conaffinity="0"/>
<site name="tool" size="0.003" rgba="1 0 0 0"/>
<camera name="wrist" pos="-0.1 0 0.1" xyaxes="0 -1 0 0.85 0 0.53" fovy="75"/>
<body name="left" gravcomp="1"><joint name="left" type="slide" axis="0 1 0" range="0 {open}" limited="true"/>
<geom type="box" size="0.01 0.005 0.04" pos="0 0.005 0.035" mass="0.05" friction="1 0.02 0.001"
priority="200000" rgba="0.15 0.15 0.16 1"/></body>
<body name="right" gravcomp="1">
<joint name="right" type="slide" axis="0 -1 0" range="0 {open}" limited="true"/>
<geom type="box" size="0.01 0.005 0.04" pos="0 -0.005 0.035" mass="0.05" friction="1 0.02 0.001"
priority="200000" rgba="0.15 0.15 0.16 1"/></body>
</body></worldbody><actuator>
<position name="x" joint="x" kp="3000" dampratio="1"/><position name="y" joint="y" kp="3000" dampratio="1"/>
<position name="z" joint="z" kp="3000" dampratio="1"/><position name="yaw" joint="yaw" kp="60" dampratio="1"/>
<position name="left" joint="left" kp="3000" dampratio="1" forcerange="-40 40"/>
<position name="right" joint="right" kp="3000" dampratio="1" forcerange="-40 40"/>
</actuator></mujoco>"""
_NAMES = ("x", "y", "z", "yaw", "left", "right")


def _complete():
    """The folder of the whole repository: a hub may have fetched this file alone."""
    if (_FOLDER / "bank").is_dir():
        return _FOLDER
    from huggingface_hub import snapshot_download

    kind, owner, name = _FOLDER.parents[1].name.split("--", 2)
    return Path(
        snapshot_download(f"{owner}/{name}", revision=_FOLDER.name, repo_type=kind.rstrip("s"))
    )


class ClutterLift(gym.Env):
    """Lift the target by 10 cm. Every reset draws a scene of the bank, and one of its objects.

    Observations: `pixels` of the cameras `front` and `wrist`, and `agent_pos`: the gripper's position from
    the region's centre, its turn, and how far each finger is from the middle. Rewards: 1 at success, else 0.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": _CONTROL}  # noqa: RUF012

    def __init__(self, bank, render_mode="rgb_array", pixels=True):
        sys.path.insert(0, str(Path(bank).parent))
        from bank_reader import Bank

        self.bank = Bank(bank)
        self.render_mode = render_mode
        self._has_pixels = pixels
        self._max_episode_steps = _STEPS
        self.task = "lift"
        self.task_description = "lift an object"
        self.action_space = gym.spaces.Box(-1, 1, (5,), np.float32)
        image = gym.spaces.Box(0, 255, (*_PIXELS, 3), np.uint8)
        spaces = {"agent_pos": gym.spaces.Box(-np.inf, np.inf, (6,), np.float32)}
        if pixels:
            spaces["pixels"] = gym.spaces.Dict({"front": image, "wrist": image})
        self.observation_space = gym.spaces.Dict(spaces)
        self._renderer = None

    def reset(self, *, seed=None, options=None):
        """Options: `scene`, its number; `target`, the name of one of its objects."""
        import mujoco

        super().reset(seed=seed)
        options = options or {}
        number = options.get("scene")
        scene = self.bank.reset(self.np_random) if number is None else self.bank.scene(number)
        self.target = options.get("target") or str(self.np_random.choice(scene.names))
        self.task_description = f"lift the {self.bank.asset(self.target).label}"
        region = self.bank.region
        self._top = float(self.bank.support.record["top"])
        self._origin = np.array([*region["center"], self._top])
        spec = mujoco.MjSpec.from_string(self.bank.xml(scene.index))
        gripper = mujoco.MjSpec.from_string(_GRIPPER.format(open=_OPEN))
        spec.attach(gripper, prefix="gripper-", frame=spec.worldbody.add_frame(pos=self._origin))
        eye = self._origin + np.array([0, -0.75, 0.5])
        spec.worldbody.add_camera(name="front", pos=eye, xyaxes=[1, 0, 0, 0, 0.55, 0.83], fovy=50)
        for key in list(spec.keys):
            spec.delete(key)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._joints = [self.model.joint(f"gripper-{name}").qposadr[0] for name in _NAMES]
        mujoco.mj_forward(self.model, self.data)
        self._start = max(_START, self._highest(scene.names) - self._top + _CLEAR)
        self._aim = np.array([0, 0, self._start, 0, _OPEN, _OPEN])
        self.data.qpos[self._joints] = self.data.ctrl[:] = self._aim
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None
        self._num_steps = 0
        mujoco.mj_forward(self.model, self.data)
        bodies = self.model.geom_bodyid[self.data.contact.geom[self.data.contact.dist < 0]]
        if (self.model.body_rootid[bodies] == self.model.body("gripper-gripper").id).any():
            raise ValueError(
                "no room for the gripper above the region: a bank on an open top is needed"
            )
        self._height = self.data.body(self.target).xpos[2]
        return self._observe(), {"scene": scene.index, "target": self.target, "is_success": False}

    def _highest(self, names):
        """Metres: the top of the highest of these objects, by the boxes of their geoms."""
        bodies = [self.model.body(name).id for name in names]
        geoms = [geom for geom in range(self.model.ngeom) if self.model.geom_bodyid[geom] in bodies]
        center = self.model.geom_aabb[geoms, :3]
        half = self.model.geom_aabb[geoms, 3:]
        up = self.data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]
        return (
            self.data.geom_xpos[geoms, 2] + (up * center).sum(1) + (np.abs(up) * half).sum(1)
        ).max()

    def step(self, action):
        import mujoco

        action = np.clip(np.asarray(action, np.float64), -1, 1)
        self._aim[:4] += action[:4] * _SPEED / _CONTROL
        self._aim[2] = np.clip(self._aim[2], 0.005, max(0.6, self._start))
        self._aim[4:] = _OPEN * (action[4] > 0)
        self.data.ctrl[:] = self._aim
        mujoco.mj_step(self.model, self.data, round(1 / _CONTROL / self.model.opt.timestep))
        self._num_steps += 1
        is_success = bool(self.data.body(self.target).xpos[2] - self._height > _LIFT)
        info = {"is_success": is_success}
        return self._observe(), float(is_success), is_success, self._num_steps >= _STEPS, info

    def render(self):
        """The picture of the camera `front`."""
        return self._picture("front")

    def close(self):
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _observe(self):
        seen = {"agent_pos": self.data.qpos[self._joints].astype(np.float32)}
        if self._has_pixels:
            seen["pixels"] = {
                "front": self._picture("front"),
                "wrist": self._picture("gripper-wrist"),
            }
        return seen

    def _picture(self, camera):
        import mujoco

        if self._renderer is None:
            self._renderer = mujoco.Renderer(self.model, *_PIXELS)
        self._renderer.update_scene(self.data, camera)
        return self._renderer.render()


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """What LeRobot calls: a vector of environments."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    kind = gym.vector.AsyncVectorEnv if use_async_envs and n_envs > 1 else gym.vector.SyncVectorEnv
    envs = kind([partial(ClutterLift, str(_complete() / "bank"))] * n_envs)
    return {"cluttergen": {0: envs}}
