"""The project's objects and supports as a Drake plant: the same hulls, masses, inertias and friction."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.obj import mesh_text
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.scene.export.frames import friction_of, harmonic_of
from cluttergen_jax.scene.export.sdf import HYDROELASTIC_MODULUS


class DrakePeer:
    """Drake's discrete plant: a fresh simulator for every scene.

    Hulls and boxes are compliant hydroelastic bodies (`HYDROELASTIC_MODULUS`, as in the SDF export), so that
    they touch over areas: Drake's point contact has one point for each two hulls, on which nothing flat can
    stand still. Where a simulation diverges, poses are NaN from then on.
    """

    def __init__(self, models: SceneModels) -> None:
        try:
            import pydrake.all as drake
        except ImportError as error:
            raise MissingExtraError("peers", "survival in Drake") from error
        self._drake, self._models = drake, models
        self._files = tempfile.TemporaryDirectory()

    def begin(self, objects: np.ndarray, poses: np.ndarray) -> Callable[[int], np.ndarray]:
        """See `survival.Peer.begin`."""
        drake, models = self._drake, self._models
        builder = drake.DiagramBuilder()
        plant, graph = drake.AddMultibodyPlantSceneGraph(builder, models.stability.timestep)
        plant.set_contact_model(drake.ContactModel.kHydroelasticWithFallback)
        graph.set_config(self._contact_config())
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -models.contact.gravity])
        self._add_support(plant)
        bodies = [self._add_object(plant, int(k)) for k in objects]
        plant.Finalize()
        diagram = builder.Build()
        simulator = drake.Simulator(diagram)
        root = simulator.get_mutable_context()
        context = plant.GetMyMutableContextFromRoot(root)
        for body, pose in zip(bodies, poses, strict=True):
            place = drake.RigidTransform(drake.Quaternion(pose[3:]), pose[:3])
            plant.SetFreeBodyPose(context, body, place)
        simulator.Initialize()

        lost = np.full((len(bodies), 7), np.nan)
        has_diverged = False

        def step(count: int) -> np.ndarray:
            nonlocal has_diverged
            if has_diverged:
                return lost
            try:
                simulator.AdvanceTo(root.get_time() + count * models.stability.timestep)
            except RuntimeError as error:
                if "non-finite" not in str(error):
                    raise
                has_diverged = True
                return lost
            return np.array([_pose(plant.EvalBodyPoseInWorld(context, body)) for body in bodies])

        return step

    def _contact_config(self) -> Any:
        config = self._drake.SceneGraphConfig()
        config.default_proximity_properties.compliance_type = "compliant"
        config.default_proximity_properties.hydroelastic_modulus = HYDROELASTIC_MODULUS
        return config

    def _add_support(self, plant: Any) -> None:
        drake, sliding = self._drake, self._models.contact.friction[0]
        for number, box in enumerate(self._models.world.support.boxes):
            place = drake.RigidTransform(drake.RollPitchYaw(0, 0, box.yaw), box.center)
            shape = drake.Box(*(2 * side for side in box.half_extents))
            plant.RegisterCollisionGeometry(
                plant.world_body(), place, shape, f"support-{number}", self._friction(sliding)
            )

    def _add_object(self, plant: Any, k: int) -> Any:
        drake, asset = self._drake, self._models.world.objects[k]
        mass = asset.mass * self._models.mass_scale[k]
        unit = np.asarray(asset.inertia) / asset.mass
        inertia = drake.UnitInertia(*np.diag(unit), unit[0, 1], unit[0, 2], unit[1, 2])
        center = np.asarray(asset.center_of_mass, np.float64)
        about_origin = inertia.ShiftFromCenterOfMass(center)
        body = plant.AddRigidBody(
            self._models.world.names[k], drake.SpatialInertia(mass, center, about_origin)
        )
        friction = self._friction(friction_of(asset, self._models.contact)[0])
        for number, path in enumerate(self._hulls(k)):
            plant.RegisterCollisionGeometry(
                body, drake.RigidTransform(), drake.Convex(str(path)), f"part-{number}", friction
            )
        return body

    def _friction(self, wanted: float) -> Any:
        """Of a body that is to have this coefficient with the support; see `scene.export.frames`."""
        own = harmonic_of(wanted, self._models.contact.friction[0])
        return self._drake.CoulombFriction(own, own)

    def _hulls(self, k: int) -> list[Path]:
        folder = Path(self._files.name)
        paths = []
        for number, part in enumerate(self._models.world.objects[k].parts):
            path = folder / f"{k}-{number}.obj"
            if not path.exists():
                path.write_text(mesh_text(part.hull()), encoding="ascii")
            paths.append(path)
        return paths

    def close(self) -> None:
        """Removes its files."""
        self._files.cleanup()


def _pose(transform: Any) -> np.ndarray:
    """f64[7]: position, then quaternion wxyz."""
    return np.concatenate([transform.translation(), transform.rotation().ToQuaternion().wxyz()])
