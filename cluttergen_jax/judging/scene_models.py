"""Plain MuJoCo models of what stands in a scene, and nothing else: as its saved file has it."""

from __future__ import annotations

import copy
import threading
from collections import OrderedDict
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import add_object, add_support, new_spec
from cluttergen_jax.config import ContactConfig, Detector, StabilityConfig
from cluttergen_jax.evaluation.measures.arrangement import check_scenes
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.simulations import disabled_flags
from cluttergen_jax.placement.world import World

_MAX_MODELS = 64
_FLOOR = (4.0, 4.0, 0.1)


@dataclass(frozen=True, eq=False)
class SceneModel:
    """One set of objects on the support, over a floor. n objects.

    Attributes:
      layout: of the compiled model; nothing sleeps, and what diverges is seen, not reset.
      objects: i64[n], which of the world's objects they are, ascending.
    """

    layout: Layout
    objects: np.ndarray

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model, shared by all scenes of these objects: copy it before changing it."""
        return self.layout.model

    def own_model(self) -> mujoco.MjModel:
        """A copy that may be changed."""
        return copy.copy(self.layout.model)

    def start(self, poses: np.ndarray, model: mujoco.MjModel | None = None) -> mujoco.MjData:
        """A simulation at rest with the objects at poses f[K, 7], world, metres, wxyz, forward computed."""
        model = model or self.model
        data = mujoco.MjData(model)
        start = np.asarray(poses, np.float64)[self.objects].copy()
        start[:, 3:] /= np.linalg.norm(start[:, 3:], axis=1, keepdims=True)
        data.qpos[:] = start.ravel()
        mujoco.mj_forward(model, data)
        return data


class SceneModels:
    """Compiles a model for each set of objects that is asked for, and keeps the latest 64.

    Args:
      world: whose objects and support.
      stability: its time step counts.
      contact: friction and solver.
      mass_scale: f[K] or one number, by which each object's mass and inertia are multiplied.
      detector: of convex collisions.
    """

    def __init__(
        self,
        world: World,
        stability: StabilityConfig | None = None,
        contact: ContactConfig | None = None,
        mass_scale: np.ndarray | float = 1.0,
        detector: Detector = "native",
    ) -> None:
        self.world = world
        self.detector = detector
        self.stability = stability or StabilityConfig()
        self.contact = contact or ContactConfig()
        self.mass_scale = np.broadcast_to(np.asarray(mass_scale, np.float64), (world.num_objects,))
        self._cache: OrderedDict[bytes, SceneModel] = OrderedDict()
        self._lock = threading.Lock()

    def with_detector(self, detector: Detector) -> SceneModels:
        """The same scenes with another detector of convex collisions."""
        return SceneModels(self.world, self.stability, self.contact, self.mass_scale, detector)

    def check(self, poses: np.ndarray, is_placed: np.ndarray) -> None:
        """ConfigError unless they are scenes of this world: poses f[N, K, 7], is_placed bool[N, K]."""
        check_scenes(poses, is_placed, self.world.num_objects)

    def of(self, is_placed: np.ndarray) -> SceneModel:
        """The model of the objects that stand: bool[K]."""
        key = np.asarray(is_placed, bool).tobytes()
        with self._lock:
            if key not in self._cache:
                self._cache[key] = self._compile(np.flatnonzero(is_placed))
                if len(self._cache) > _MAX_MODELS:
                    self._cache.popitem(last=False)
            self._cache.move_to_end(key)
            return self._cache[key]

    def _compile(self, objects: np.ndarray) -> SceneModel:
        spec = new_spec(self.stability.timestep, self.contact)
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=_FLOOR)
        add_support(spec, self.world.support)
        for k in objects:
            add_object(spec, self.world.objects[k], self.world.names[k])
        model = spec.compile()
        model.opt.disableflags = disabled_flags(model, self.detector)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        scale = self.mass_scale[objects]
        if (scale != 1).any():
            bodies = model.jnt_bodyid
            model.body_mass[bodies] *= scale
            model.body_inertia[bodies] *= scale[:, None]
            mujoco.mj_setConst(model, mujoco.MjData(model))
        return SceneModel(Layout.of(model, self.world.support.top), objects)
