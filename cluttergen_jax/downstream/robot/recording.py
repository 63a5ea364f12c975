"""Recordings of episodes: what the arm did, felt and was told at every frame, and what cameras saw."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE, wrist_camera
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.motion.execute import Trace
from cluttergen_jax.downstream.transforms import pose_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotate_in_plane
from cluttergen_jax.rendering import CameraView, add_lighting, open_renderer, set_range
from cluttergen_jax.sensing import Camera, CameraPlan, parse_cameras

FPS = 20
"""Frames per second of simulated time."""
THIRD = "third"
WRIST = "wrist"
# Metres from the region's middle on the top, in the region's axes: the camera `third`, across the table.
_EYE = (1.25, 0.6, 0.9)
_LOOKED_AT = (-0.2, 0.0, 0.22)

_REACH = 1.5


@dataclass(frozen=True, eq=False)
class EpisodeRecording:
    """One episode, T frames.

    Attributes:
      number: of the episode. task: what it was to do, in words. is_success: how it ended.
      trace: what was kept of it.
      cameras: by name; None is the one on the hand.
    """

    number: int
    task: str
    is_success: bool
    trace: Trace
    cameras: Mapping[str, Camera | None]

    def __len__(self) -> int:
        return len(self.trace.states)

    @property
    def names(self) -> list[str]:
        """Of the entries of `state` and `action`."""
        return [f"joint{k + 1}" for k in range(len(self.trace.arm.qpos))] + ["finger_opening"]

    @cached_property
    def qpos(self) -> np.ndarray:
        """f64[T, nq]: the whole simulation's."""
        return np.array(self.trace.states)

    @property
    def state(self) -> np.ndarray:
        """f32[T, J + 1]: radians of the joints, and metres of each finger from the middle."""
        joints = self.qpos[:, self.trace.arm.qpos]
        return np.column_stack([joints, self.trace.openings]).astype(np.float32)

    @property
    def action(self) -> np.ndarray:
        """f32[T, J + 1]: set-points that lead from a frame to the next, as `state`.

        That of the fingers is negative where they shall press on something.
        """
        arm = self.trace.arm
        told = np.array([*self.trace.controls[1:], self.trace.controls[-1]])
        asked = gripper_of(self.trace.robot).opening_at(told[:, arm.grip])
        return np.column_stack([told[:, arm.ctrl], asked]).astype(np.float32)

    @cached_property
    def _hand(self) -> tuple[np.ndarray, np.ndarray]:
        """f64[T, 4, 4], T_world_tool; bool[T], the hand touches something that is not the arm."""
        tools = []
        touches = []
        arm = self.trace.arm
        model = self._model
        is_hand = arm.is_hand
        for data in self._states():
            mujoco.mj_collision(model, data)
            bodies = model.geom_bodyid[data.contact.geom[data.contact.dist <= 0]]
            touches.append(bool((is_hand[bodies] & ~arm.is_arm[bodies[:, ::-1]]).any()))
            tools.append(arm.tool(data))
        return np.array(tools), np.array(touches)

    @property
    def tool_pose(self) -> np.ndarray:
        """f32[T, 7]: T_world_tool, metres, wxyz."""
        return pose_of(self._hand[0]).astype(np.float32)

    @property
    def contact(self) -> np.ndarray:
        """bool[T]: the hand touches something."""
        return self._hand[1]

    @cached_property
    def _model(self) -> mujoco.MjModel:
        model = add_lighting(self.trace.spec_on_pedestals()).compile()
        # Shadows take six sevenths of the time of a picture without a GPU.
        model.light_castshadow[:] = False
        return model

    def _states(self) -> Iterator[mujoco.MjData]:
        data = mujoco.MjData(self._model)
        for state in self.qpos:
            data.qpos[:] = state
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            yield data

    def pictures(self, name: str) -> Iterator[np.ndarray]:
        """u8[H, W, 3] of every frame by a camera. Raises RendererError: nothing here can draw."""
        fixed = self.cameras[name]
        model = self._model
        width, height = SIZE if fixed is None else (fixed.width, fixed.height)
        middle = [*self.trace.scene.support.region.center, self.trace.scene.support.top]
        set_range(
            model, np.add(middle, _REACH * np.array([[-1], [1]])), CameraView(), width, height
        )
        with open_renderer(model, width, height) as renderer:
            for data in self._states():
                camera = wrist_camera(self.trace.arm.tool(data)) if fixed is None else fixed
                yield renderer.average(data, camera, 1, _REACH)


def _third_camera(support: SupportAsset) -> Camera:
    region = support.region
    eye, target = (
        [*(rotate_in_plane(np.array(each[:2]), region.yaw) + region.center), support.top + each[2]]
        for each in (_EYE, _LOOKED_AT)
    )
    return Camera.looking(np.array(eye), np.array(target), *SIZE, FOCAL)


@dataclass(frozen=True)
class RecordCameras:
    """Cameras that are recorded.

    Attributes:
      own: whether the cameras `third` (across the table) and `wrist` are among them, in their order.
      plans: the others; those that do not stand at a fixed place are drawn for each episode.
    """

    own: tuple[str, ...]
    plans: tuple[CameraPlan, ...]

    @staticmethod
    def of(asked: Sequence[str | Path]) -> RecordCameras:
        """By name, or files (`parse_cameras`). Raises ConfigError: there is no such camera."""
        if isinstance(asked, str | Path):
            raise ConfigError(
                f"record_cameras = {asked!r}", "a sequence of names", f"({str(asked)!r},)"
            )
        names = [str(each) for each in asked]
        plans: list[CameraPlan] = []
        for name in names:
            if name not in (THIRD, WRIST):
                plans += parse_cameras([name], None if name.endswith(".json") else SIZE)
        found = RecordCameras(tuple(name for name in names if name in (THIRD, WRIST)), tuple(plans))
        known = list(found.sizes)
        if len(known) < len(found.own) + len(plans):
            raise ConfigError(f"record_cameras = {names}", "each name once")
        return found

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Width and height by name, pixels."""
        return dict.fromkeys(self.own, SIZE) | {plan.name: plan.size for plan in self.plans}

    def place(self, support: SupportAsset, seed: tuple[int, int]) -> dict[str, Camera | None]:
        """The cameras of an episode; None is the one on the hand."""
        rng = np.random.default_rng(seed)
        found: dict[str, Camera | None] = {
            name: None if name == WRIST else _third_camera(support) for name in self.own
        }
        return found | {plan.name: plan.draw(support, rng) for plan in self.plans}
