"""Survival of finished scenes in another physics engine, with the same hulls, masses and friction."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.measures import bullet_world
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.simulate import Movement, each_scene, no_movement, watch

PEERS = ("pybullet", "drake")
SURVIVAL_SECONDS = (10.0,)
BULLET_MARGIN = 1e-4
MOST_SINKING = 0.005
"""Metres. PyBullet lets each layer of a heap sink by about 1 mm."""


class Peer(Protocol):
    """Another engine that can be given a scene."""

    def begin(self, objects: np.ndarray, poses: np.ndarray) -> Callable[[int], np.ndarray]:
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
        # Drake is an import of seconds.
        from cluttergen_jax.evaluation.measures.drake_world import DrakePeer

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
    """How far objects move in another engine; `Movement.survives` says which scenes stand (5 mm, 5 deg).

    What all objects of a scene sink together, their median and `MOST_SINKING` at most, is not counted.

    Hulls, masses, inertias, sliding friction, gravity and time step are the scene's own (two objects that
    both have a friction of their own slide by the engine's rule for two bodies); everything else is the other
    engine's default but for the hulls' margin in PyBullet (`BULLET_MARGIN`, metres) and the bodies'
    stiffness in Drake (`drake_world.HYDROELASTIC_MODULUS`).

    Args:
      engine: "pybullet" or "drake" (extra `peers`).
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
      seconds: horizons, ascending.
      num_threads: each with an engine of its own, 0 for every core; PyBullet uses one at a time.
    """
    models.check(poses, is_placed)
    poses, is_placed = np.asarray(poses, np.float64), np.asarray(is_placed, bool)
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
                shift, turn = watch(step, start, result.seconds, models.stability.timestep, MOST_SINKING)
                result.shift[scene][:, objects], result.turn[scene][:, objects] = shift, turn
        finally:
            peer.close()

    each_scene(run, threads, threads)
    return result


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

    def begin(self, objects: np.ndarray, poses: np.ndarray) -> Callable[[int], np.ndarray]:
        """See `Peer.begin`."""
        self._disconnect()
        bullet, models = self._bullet, self._models
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
            body = bullet_world.add_object(bullet, client, self._compound(k), mass, inertia, friction)
            never = bullet.ACTIVATION_STATE_DISABLE_SLEEPING
            bullet.changeDynamics(
                body, -1, collisionMargin=BULLET_MARGIN, activationState=never, physicsClientId=client
            )
            bullet.resetBasePositionAndOrientation(body, place[:3], place[3:], physicsClientId=client)
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
