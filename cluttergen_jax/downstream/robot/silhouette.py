"""The arm in its own pictures: pixels that show it or what it brings, known from its joints alone."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.ndimage import binary_dilation

from cluttergen_jax.assets.mjcf import VISUAL_GROUP, add_part
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.model import Panda, panda_spec
from cluttergen_jax.sensing.camera import Camera
from cluttergen_jax.sensing.rays import cast_rays

_GROWN = 3
"""Pixels around it that are left out, too: what is in front grows in a noisy picture."""
_ROOT, _BROUGHT = "link0", "brought"
_DRAWN = np.isin(np.arange(mujoco.mjNGROUP), VISUAL_GROUP).astype(np.uint8)


class ArmSilhouette:
    """Says which pixels of a picture the arm and one object cover.

    Args:
      base: f64[7], T_world_base. asset: the object that it brings; None leaves only the arm out.
    """

    def __init__(self, base: np.ndarray, asset: ObjectAsset | None = None) -> None:
        spec = panda_spec(ContactConfig())
        root = spec.body(_ROOT)
        root.pos, root.quat = base[:3], base[3:]
        brought = spec.worldbody.add_body(name=_BROUGHT)
        for index, part in enumerate(() if asset is None else asset.parts):
            add_part(spec, brought, f"{_BROUGHT}/part-{index}", part.vertices).group = VISUAL_GROUP
        self._model = spec.compile()
        self._data, self._arm = mujoco.MjData(self._model), Panda.of(self._model, prefix="")
        self._brought = self._model.body(_BROUGHT).id

    def __call__(
        self, camera: Camera, joints: np.ndarray, opening: float, pose: np.ndarray | None = None
    ) -> np.ndarray:
        """bool[H, W]: pixels that may show them.

        Args:
          camera: where it is believed to stand.
          joints: f64[7]; opening: metres of each finger from the middle; pose: f64[7],
            T_world_object, where there is one.
        """
        model, data = self._model, self._data
        data.qpos[self._arm.qpos], data.qpos[self._arm.fingers] = joints, opening
        if pose is not None:
            model.body_pos[self._brought], model.body_quat[self._brought] = pose[:3], pose[3:]
        mujoco.mj_kinematics(model, data)
        covered = np.isfinite(cast_rays(model, data, camera, _DRAWN)[0])
        return binary_dilation(covered, np.ones((3, 3)), _GROWN)
