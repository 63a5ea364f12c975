"""Survival of finished scenes in another physics engine, with the same hulls, masses and friction."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cluttergen_jax.assets.obj import mesh_text
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.judging.scene_models import Movement, SceneModels, each_scene, no_movement
from cluttergen_jax.physics.standing import Advance
from cluttergen_jax.scene.export.links import HYDROELASTIC_MODULUS
from cluttergen_jax.scene.export.shapes import friction_of, harmonic_of
from studies.measures import bullet_world

PEERS = ("pybullet", "drake")
SURVIVAL_SECONDS = (10.0,)
BULLET_MARGIN = 1e-4
MOST_SINKING = 0.005
"""Metres. PyBullet lets each layer of a heap sink by about 1 mm."""


class Peer(Protocol):
    """Another engine that can be given a scene."""

    def begin(self, objects: np.ndarray, poses: np.ndarray) -> Advance:
        """Puts objects i64[n] at rest at poses f64[n, 7], world, metres, wxyz; nothing else is there.

        Returns:
          A function that makes so many steps and returns the poses f64[n, 7] after them.
        """
        ...

    def close(self) -> None:
        """Gives back what the engine holds."""
        ...


def make_peer(engine: str, models: SceneModels) -> Peer:
    """A peer with the world, time step and contact of `models`.

    Raises:
      ConfigError: no engine of that name; MissingExtraError: it is not installed.
    """
    if engine == "pybullet":
        return BulletPeer(models)
    if engine == "drake":
        return DrakePeer(models)
    raise ConfigError(f"engine {engine!r}", ", ".join(PEERS))


def movement_elsewhere(
    engine: str,
    models: SceneModels,
    poses: np.ndarray,
    is_placed: np.ndarray,
    seconds: Sequence[float] = SURVIVAL_SECONDS,
    num_threads: int = 0,
) -> Movement:
    """How far objects move in another engine; `Movement.survives` says which scenes stand.

    What all objects of a scene sink together, their median and `MOST_SINKING` at most, is not counted.

    Hulls, masses, inertias, sliding friction, gravity and time step are the scene's own (two objects that
    both have a friction of their own slide by the engine's rule for two bodies); everything else is the other
    engine's default but for the hulls' margin in PyBullet (`BULLET_MARGIN`, metres) and, in Drake, the
    bodies' stiffness (`scene.export.links.HYDROELASTIC_MODULUS`) and the solver, SAP.

    Args:
      engine: "pybullet" or "drake" (extra `peers`).
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: horizons, ascending.
      num_threads: each with an engine of its own, 0 for every core; PyBullet uses one at a time.
    """
    models.check(poses, is_placed)
    poses = np.asarray(poses, np.float64)
    is_placed = np.asarray(is_placed, bool)
    result = no_movement(is_placed, seconds)
    threads = min(num_threads or os.cpu_count() or 1, max(len(is_placed), 1))

    def run(thread: int) -> None:
        peer = make_peer(engine, models)
        try:
            for scene in range(thread, len(is_placed), threads):
                objects = np.flatnonzero(is_placed[scene])
                start = poses[scene, objects].copy()
                start[:, 3:] /= np.linalg.norm(start[:, 3:], axis=1, keepdims=True)
                step = peer.begin(objects, start)
                lifted = _without_sinking(step, start)
                result.watch(scene, objects, lifted, start, models)
        finally:
            peer.close()

    each_scene(run, threads, threads)
    return result


def _without_sinking(step: Advance, start: np.ndarray) -> Advance:
    """The same simulation, its poses lifted by what most objects have sunk since `start`, f64[n, 7].

    Engines with soft contacts let every layer of a heap sink by as much, which is no fall.
    """

    def advance(count: int) -> np.ndarray:
        poses = step(count)
        sinking = np.median(poses[:, 2] - start[:, 2]) if len(poses) else 0.0
        if not np.isfinite(sinking):
            return poses
        lifted = poses.copy()
        lifted[:, 2] += min(max(-sinking, 0.0), MOST_SINKING)
        return lifted

    return advance


class BulletPeer:
    """PyBullet: a fresh client for every scene, multi-bodies, everything awake.

    Bullet keeps hulls apart by a margin of 1 mm each, which lifts a stack of three by 5 mm without anything
    being amiss; here the margin is a tenth of a millimetre.
    """

    def __init__(self, models: SceneModels) -> None:
        self._bullet = bullet_world.load_pybullet("survival in PyBullet")
        self._models = models
        self._frames = bullet_world.BodyFrames.of(models.world.objects)
        self._files = tempfile.TemporaryDirectory()
        self._client: int | None = None

    def begin(self, objects: np.ndarray, poses: np.ndarray) -> Advance:
        """See `Peer.begin`."""
        self._disconnect()
        bullet = self._bullet
        models = self._models
        client = self._client = bullet.connect(bullet.DIRECT)
        bullet.setGravity(0, 0, -models.contact.gravity, physicsClientId=client)
        bullet.setTimeStep(models.stability.timestep, physicsClientId=client)
        on_support = bullet_world.support_friction(models.contact)
        bullet_world.add_support(bullet, client, models.world.support, on_support)
        places = self._frames.body_poses(objects.tolist(), poses).tolist()
        bodies = []
        for k, place in zip(objects.tolist(), places, strict=True):
            asset = models.world.objects[k]
            mass = asset.mass * models.mass_scale[k]
            friction = bullet_world.object_friction(asset, models.contact)
            inertia = self._frames.inertia[k] * models.mass_scale[k]
            body = bullet_world.add_object(
                bullet, client, self._compound(k), mass, inertia, friction
            )
            never = bullet.ACTIVATION_STATE_DISABLE_SLEEPING
            bullet.changeDynamics(
                body,
                -1,
                collisionMargin=BULLET_MARGIN,
                activationState=never,
                physicsClientId=client,
            )
            bullet.resetBasePositionAndOrientation(
                body, place[:3], place[3:], physicsClientId=client
            )
            bodies.append(body)
        return lambda count: self._step(client, objects.tolist(), bodies, count)

    def _step(self, client: int, objects: list[int], bodies: list[int], count: int) -> np.ndarray:
        for _ in range(count):
            self._bullet.stepSimulation(physicsClientId=client)
        place_of = self._bullet.getBasePositionAndOrientation
        places = [sum(place_of(body, physicsClientId=client), ()) for body in bodies]
        return self._frames.object_poses(objects, np.array(places).reshape(-1, 7))

    def _compound(self, k: int) -> Path:
        path = Path(self._files.name) / f"{k}.obj"
        if not path.exists():
            bullet_world.write_compound(path, self._models.world.objects[k], self._frames, k)
        return path

    def _disconnect(self) -> None:
        if self._client is not None:
            self._bullet.disconnect(self._client)
            self._client = None

    def close(self) -> None:
        """Ends the client and removes its files."""
        self._disconnect()
        self._files.cleanup()


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
        self._drake = drake
        self._models = models
        self._files = tempfile.TemporaryDirectory()

    def begin(self, objects: np.ndarray, poses: np.ndarray) -> Advance:
        """See `Peer.begin`."""
        drake = self._drake
        models = self._models
        builder = drake.DiagramBuilder()
        plant, graph = drake.AddMultibodyPlantSceneGraph(builder, models.stability.timestep)
        plant.set_contact_model(drake.ContactModel.kHydroelasticWithFallback)
        # By its default, `lagged`, what stands creeps, turns and falls.
        plant.set_discrete_contact_approximation(drake.DiscreteContactApproximation.kSap)
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
        drake = self._drake
        sliding = self._models.contact.friction[0]
        for number, box in enumerate(self._models.world.support.boxes):
            place = drake.RigidTransform(drake.RollPitchYaw(0, 0, box.yaw), box.center)
            shape = drake.Box(*(2 * side for side in box.half_extents))
            plant.RegisterCollisionGeometry(
                plant.world_body(), place, shape, f"support-{number}", self._friction(sliding)
            )
        for number, part in enumerate(self._models.world.support.parts):
            path = Path(self._files.name) / f"support-{number}.obj"
            path.write_text(mesh_text(part.hull()), encoding="ascii")
            plant.RegisterCollisionGeometry(
                plant.world_body(),
                drake.RigidTransform(),
                drake.Convex(str(path)),
                f"support-part-{number}",
                self._friction(sliding),
            )

    def _add_object(self, plant: Any, k: int) -> Any:
        drake = self._drake
        asset = self._models.world.objects[k]
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
        """Of a body that is to have this coefficient with the support; see `scene.export.shapes`."""
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
