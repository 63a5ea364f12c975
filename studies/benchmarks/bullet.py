"""PyBullet behind the same interface, for comparison: plain, or made as fast as its interface allows.

One compound body per object of the same hulls, the true mass and inertia, the same friction, early stop by
the same rule on plain floats, PyBullet's defaults elsewhere. One client per scene stays as it is between
calls, and only what is not where it should be is put back. Plain: multi-bodies, everything awake, neighbours
watched at every step. Tuned: rigid bodies, neighbours asleep until touched and looked at once, at the end.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics.host import below_top, empty_settling, empty_standing
from cluttergen_jax.physics.standing import displacement
from cluttergen_jax.placement.world import World
from cluttergen_jax.types import Settling, Standing, Verdict
from studies.measures.bullet_world import (
    BodyFrames,
    add_object,
    add_support,
    object_friction,
    support_friction,
    write_compound,
)

try:
    import pybullet
except ImportError:
    pybullet = None

_PARKING = 20.0
_Place = tuple[tuple[float, ...], tuple[float, ...]]


@dataclass(eq=False)
class _Client:
    """One scene: a PyBullet world and where everything was left.

    Attributes:
      poses: f32[K, 7], the object poses at which bodies were last put or found.
    """

    id: int
    bodies: list[int]
    poses: np.ndarray


class BulletPhysics:
    """`BatchEngine` on PyBullet, one thread.

    Args:
      world: the compiled world whose objects and support are built again.
      tuned: see above.
    """

    def __init__(
        self, world: World, config: StabilityConfig, contact: ContactConfig, tuned: bool
    ) -> None:
        self.config = config
        self._contact = contact
        self._tuned = tuned
        self._world = world
        self._frames = BodyFrames.of(world.objects)
        self._parked = np.tile(np.array([0, 0, 1, 1, 0, 0, 0], np.float32), (world.num_objects, 1))
        self._parked[:, 0] = _PARKING + np.arange(world.num_objects)
        self._clients: list[_Client] = []
        self._files = tempfile.TemporaryDirectory()
        self._meshes = [self._write(index, asset) for index, asset in enumerate(world.objects)]

    def close(self) -> None:
        """Ends all clients."""
        for client in self._clients:
            pybullet.disconnect(client.id)
        self._clients.clear()
        self._files.cleanup()

    def settle_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, focus: np.ndarray, is_active: np.ndarray
    ) -> Settling:
        """One attempt in each active scene; trajectories and motion sums are left out."""
        self._make_room(len(poses))
        result = empty_settling(np, (len(poses),), self._world.num_objects, self.config)
        result.poses[:] = poses
        for row in np.flatnonzero(is_active).tolist():
            self._settle(
                self._clients[row], poses[row], is_placed[row], int(focus[row]), result, row
            )
        return result

    def stand_batch(
        self, poses: np.ndarray, is_placed: np.ndarray, is_active: np.ndarray
    ) -> Standing:
        """The staged last check, everything awake; movements are looked at where a stage ends."""
        self._make_room(len(poses))
        result = empty_standing(np, (len(poses),), self._world.num_objects)
        for row in np.flatnonzero(is_active).tolist():
            self._stand(self._clients[row], poses[row], is_placed[row], result, row)
        return result

    def _settle(
        self,
        client: _Client,
        poses: np.ndarray,
        is_placed: np.ndarray,
        focus: int,
        result: Settling,
        row: int,
    ) -> None:
        self._arrange(client, poses, is_placed, again=focus)
        neighbours = [int(k) for k in np.flatnonzero(is_placed) if k != focus]
        if self._tuned:
            self._activate(client, neighbours, pybullet.ACTIVATION_STATE_SLEEP)
        else:
            self._activate(client, neighbours, pybullet.ACTIVATION_STATE_WAKE_UP)
        self._activate(client, [focus], pybullet.ACTIVATION_STATE_WAKE_UP)
        watched = [] if self._tuned else [client.bodies[k] for k in neighbours]
        num_steps, is_quiet, is_displaced = self._run_attempt(
            client.id, client.bodies[focus], watched
        )
        self._find(client, [focus, *neighbours])
        final = client.poses
        result.num_steps[row] = num_steps
        result.poses[row, is_placed] = final[is_placed]
        verdict = Verdict.STABLE if is_quiet else Verdict.UNSETTLED
        if is_quiet and self._overlap(client) > self.config.max_penetration:
            verdict = Verdict.PENETRATING
        shift, turn = displacement(np, final[neighbours], poses[neighbours])
        if (
            is_displaced
            or (shift > self.config.max_shift).any()
            or (turn > self.config.max_turn).any()
        ):
            verdict = Verdict.DISPLACED
        layout = self._world.layout
        if (below_top(np, final, layout.center_of_mass, layout.top) & is_placed).any():
            verdict = Verdict.FELL
        result.verdict[row] = verdict
        result.is_quiet[row] = is_quiet

    def _run_attempt(self, client: int, body: int, watched: list[int]) -> tuple[int, bool, bool]:
        """Steps until the focus object is quiet or the attempt decided: the rule of `stability`, on floats.

        Returns:
          The number of steps, whether it came to rest in time, whether a watched body went too far.
        """
        config = self.config
        hold = 0
        is_displaced = False
        step = pybullet.stepSimulation
        velocity_of = pybullet.getBaseVelocity
        max_speed = config.max_speed**2
        max_spin = config.max_angular_speed**2
        max_change = (config.max_acceleration * config.timestep) ** 2
        max_spin_change = (config.max_angular_acceleration * config.timestep) ** 2
        start = _places(client, watched)
        x0 = y0 = z0 = a0 = b0 = c0 = 0.0
        for number in range(1, config.last_step + 1):
            step(physicsClientId=client)
            (x, y, z), (a, b, c) = velocity_of(body, physicsClientId=client)
            is_quiet = (
                x * x + y * y + z * z < max_speed
                and a * a + b * b + c * c < max_spin
                and (x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2 < max_change
                and (a - a0) ** 2 + (b - b0) ** 2 + (c - c0) ** 2 < max_spin_change
            )
            x0 = x
            y0 = y
            z0 = z
            a0 = a
            b0 = b
            c0 = c
            hold = hold + 1 if is_quiet else 0
            if watched:
                is_displaced |= self._went_far(start, _places(client, watched))
            if hold >= config.quiet_steps:
                return number, number <= config.decision_step, is_displaced
        return config.last_step, False, is_displaced

    def _went_far(self, start: list[_Place], now: list[_Place]) -> bool:
        """Whether any of the watched bodies is too far from where it was, or turned too much."""
        max_shift = self.config.max_shift**2
        min_along = math.cos(self.config.max_turn / 2)
        for ((x0, y0, z0), (a0, b0, c0, d0)), ((x, y, z), (a, b, c, d)) in zip(
            start, now, strict=True
        ):
            if (x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2 > max_shift:
                return True
            if abs(a * a0 + b * b0 + c * c0 + d * d0) < min_along:
                return True
        return False

    def _stand(
        self, client: _Client, poses: np.ndarray, is_placed: np.ndarray, result: Standing, row: int
    ) -> None:
        config = self.config
        placed = np.flatnonzero(is_placed)
        self._arrange(client, poses, is_placed)
        self._activate(client, placed.tolist(), pybullet.ACTIVATION_STATE_WAKE_UP)
        for body in (client.bodies[k] for k in placed):
            pybullet.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0), physicsClientId=client.id)
        verdict = Verdict.NONE
        for until, max_shift, max_turn, otherwise in (
            (config.stand_steps, config.stand_shift, config.stand_turn, Verdict.NONE),
            (
                config.stand_full_steps,
                config.stand_full_shift,
                config.stand_full_turn,
                Verdict.CREPT,
            ),
        ):
            for _ in range(until - int(result.num_steps[row])):
                pybullet.stepSimulation(physicsClientId=client.id)
            result.num_steps[row] = until
            self._find(client, placed.tolist())
            shift, turn = displacement(np, client.poses[placed], poses[placed])
            stands = (shift <= max_shift).all() and (turn <= max_turn).all()
            verdict = Verdict.STABLE if stands else otherwise
            if verdict != Verdict.NONE:
                break
        result.verdict[row] = verdict
        result.shift[row, placed] = shift
        result.turn[row, placed] = turn

    def _arrange(
        self, client: _Client, poses: np.ndarray, is_placed: np.ndarray, again: int | None = None
    ) -> None:
        """Puts every object where it should be, unless it is there already; `again` in any case."""
        wanted = np.where(is_placed[:, None], poses, self._parked)
        is_amiss = (wanted != client.poses).any(1)
        if again is not None:
            is_amiss[again] = True
        self._put(client, np.flatnonzero(is_amiss).tolist(), wanted[is_amiss])
        self._activate(
            client, np.flatnonzero(is_amiss & ~is_placed).tolist(), pybullet.ACTIVATION_STATE_SLEEP
        )

    def _put(self, client: _Client, objects: list[int], poses: np.ndarray) -> None:
        for k, pose in zip(objects, self._frames.body_poses(objects, poses).tolist(), strict=True):
            body = client.bodies[k]
            pybullet.resetBasePositionAndOrientation(
                body, pose[:3], pose[3:], physicsClientId=client.id
            )
            pybullet.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0), physicsClientId=client.id)
        client.poses[objects] = poses

    def _find(self, client: _Client, objects: list[int]) -> None:
        """Reads where some objects are now."""
        place_of = pybullet.getBasePositionAndOrientation
        bodies = client.bodies
        places = [sum(place_of(bodies[k], physicsClientId=client.id), ()) for k in objects]
        client.poses[objects] = self._frames.object_poses(objects, np.array(places))

    def _activate(self, client: _Client, objects: list[int], state: int) -> None:
        for k in objects:
            pybullet.changeDynamics(
                client.bodies[k], -1, activationState=state, physicsClientId=client.id
            )

    def _overlap(self, client: _Client) -> float:
        """The deepest overlap of any two bodies, metres (contact distance is the ninth entry)."""
        return max(
            (-contact[8] for contact in pybullet.getContactPoints(physicsClientId=client.id)),
            default=0.0,
        )

    def _make_room(self, num_scenes: int) -> None:
        while len(self._clients) < num_scenes:
            self._clients.append(self._new_client())

    def _new_client(self) -> _Client:
        client = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0, 0, -self._contact.gravity, physicsClientId=client)
        pybullet.setTimeStep(self.config.timestep, physicsClientId=client)
        add_support(pybullet, client, self._world.support, support_friction(self._contact))
        bodies = [
            add_object(
                pybullet,
                client,
                mesh,
                asset.mass,
                inertia,
                object_friction(asset, self._contact),
                is_rigid=self._tuned,
            )
            for asset, mesh, inertia in zip(
                self._world.objects, self._meshes, self._frames.inertia, strict=True
            )
        ]
        result = _Client(client, bodies, self._parked.copy())
        everyone = list(range(len(bodies)))
        self._put(result, everyone, self._parked)
        self._activate(result, everyone, pybullet.ACTIVATION_STATE_SLEEP)
        return result

    def _write(self, index: int, asset: ObjectAsset) -> Path:
        path = Path(self._files.name) / f"{index}.obj"
        write_compound(path, asset, self._frames, index)
        return path


def _places(client: int, bodies: list[int]) -> list[_Place]:
    """Position and quaternion of each body."""
    return [pybullet.getBasePositionAndOrientation(body, physicsClientId=client) for body in bodies]
