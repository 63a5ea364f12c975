"""Actions and observations of `RobotEnv` in JAX: `joint_delta`, the arm, and the objects around it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from mujoco import mjx

from cluttergen_jax.downstream.environments.mjx_judge import Start
from cluttergen_jax.downstream.environments.world import RobotWorld
from cluttergen_jax.downstream.episodes.robot_parts import GripShare
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.geometry import Array

_OBJECT_ROW = 11
_POSE = 7


class MjxControls:
    """What an action asks of the actuators, and what is observed.

    Args:
      world: with the robot's n joints, K objects and N slots of a scene at most.
      period: seconds of a step of control.

    Attributes:
      action_size: n + 1. observation_size: 2 n + 8 + 11 N.
    """

    def __init__(self, world: RobotWorld, period: float) -> None:
        arm = world.robot
        self._arm = arm
        self._most = jnp.asarray(world.description.arm.speed, jnp.float32) * period
        share = GripShare(world.gripper, world.opened)
        self._grips = jnp.asarray([share.control_of(each) for each in (-1.0, 0.0, 1.0)])
        self._grip_step = share.speed * period
        gripper = gripper_of(world.description)
        drive = gripper.joints[:, gripper.driven].mean(1)
        order = np.argsort(drive)
        self._fingers = arm.fingers[gripper.driven]
        self._drive = jnp.asarray(drive[order], jnp.float32)
        self._opening = jnp.asarray(gripper.opening[order], jnp.float32)
        self._objects = world.object_qpos
        self._num_slots = int((np.asarray(world.bank.object_index) >= 0).sum(1).max())
        objects = world.bank.compiled.objects
        self._extents = jnp.asarray([each.half_extents for each in objects], jnp.float32)
        self.action_size = len(arm.qpos) + 1
        self.observation_size = 2 * len(arm.qpos) + 1 + _POSE + _OBJECT_ROW * self._num_slots

    def ctrl_of(self, action: Array, ctrl: Array) -> Array:
        """f32[nu]: the set-points that an action asks for, f32[n + 1], from those of now."""
        arm = self._arm
        values = jnp.clip(action, -1.0, 1.0)
        joints = jnp.clip(ctrl[arm.ctrl] + values[:-1] * self._most, arm.low, arm.high)
        grip = jnp.interp(values[-1], jnp.array([-1.0, 0.0, 1.0]), self._grips)
        change = jnp.clip(grip - ctrl[arm.grip], -self._grip_step, self._grip_step)
        return ctrl.at[arm.ctrl].set(joints).at[arm.grip].add(change)

    def poses(self, qpos: Array) -> Array:
        """f32[K, 7]: T_world_object of all objects, unit quaternions."""
        poses = qpos[self._objects]
        length = jnp.linalg.norm(poses[:, 3:], axis=-1, keepdims=True)
        return jnp.concatenate([poses[:, :3], poses[:, 3:] / length], axis=-1)

    def observe(self, data: mjx.Data, start: Start, slots: Array) -> Array:
        """f32: `agent_pos` and `environment_state` of `RobotEnv` as one vector.

        Args:
          data: after the kinematics. start: of the episode.
          slots: i32[M], the scene's objects in the order of placement, the target the last; -1 for none.
        """
        arm = self._arm
        opening = jnp.interp(data.qpos[self._fingers].mean(), self._drive, self._opening)
        hand = [
            data.qpos[arm.qpos],
            data.qvel[arm.dofs],
            opening[None],
            data.site_xpos[arm.site],
            quaternion_of(data.site_xmat[arm.site].reshape(3, 3)),
        ]
        others = jnp.where(slots == start.target, -1, slots)
        shown = jnp.concatenate([start.target[None], others])[: self._num_slots]
        rows = jnp.concatenate(
            [self.poses(data.qpos)[shown], self._extents[shown], jnp.ones((len(shown), 1))], axis=1
        )
        return jnp.concatenate([*hand, jnp.where(shown[:, None] >= 0, rows, 0.0).ravel()])


def quaternion_of(matrix: Array) -> Array:
    """f32[4], wxyz, of a rotation f32[3, 3], with the sign that MuJoCo gives it (`mju_mat2Quat`)."""
    m = matrix
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    diagonal = jnp.stack([trace, m[0, 0], m[1, 1], m[2, 2]])
    # Four times the products of each component with all four: a row for each that may be the largest.
    rows = jnp.array(
        [
            [1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], 1 - trace + 2 * m[0, 0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 - trace + 2 * m[1, 1], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - trace + 2 * m[2, 2]],
        ]
    )
    largest = jnp.where(trace > 0, 0, 1 + jnp.argmax(diagonal[1:]))
    row = rows[largest]
    return row / jnp.linalg.norm(row)
