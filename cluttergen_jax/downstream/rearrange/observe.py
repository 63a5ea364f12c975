"""Observers: where the objects of an episode are, as something that looks at it tells.

Of a running episode the robot knows what its own joints tell and what an observer says, nothing else. The
true poses are read by `TrueObserver` and by the judge (`judge`) alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from cluttergen_jax.downstream.robot import Execution
from cluttergen_jax.downstream.transforms import matrix_of, offset, pose_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.own_parts import array_of, part_name
from cluttergen_jax.rendering import CameraView, Renderer, open_renderer, set_range
from cluttergen_jax.sensing import Camera

_REACH = 1.5
"""Metres around the table that are drawn."""
_NOWHERE = np.array([0.0, 0, -50, 1, 0, 0, 0])
"""f64[7], a pose far below all else, where nothing meets anything."""
# Metres and radians from where an object is known to be within which an estimate agrees with that.
NEAR = 0.04
NEAR_TURN = float(np.radians(45))

# Certainty from which an estimate is believed: an object's first, or one that agrees with what is known, and
# one that does not.
AGREEING = 0.5
OTHERWISE = 0.7

_MOMENTS = 2
"""Moments that have told where an object is, from which on one alone does not turn it round on the spot."""


@dataclass(frozen=True, eq=False)
class SceneEstimate:
    """Where N objects are.

    Attributes:
      names: of the objects.
      pose: f64[N, 7], T_world_object, metres, wxyz; of no meaning where not seen.
      seen: bool[N].
      certainty: f64[N] in [0, 1].

    Raises:
      ConfigError: no arrays of these shapes, numbers out of range, or a pose that was seen and is none.
    """

    names: tuple[str, ...]
    pose: np.ndarray
    seen: np.ndarray
    certainty: np.ndarray

    def __post_init__(self) -> None:
        if fault := self._fault():
            raise ConfigError(
                f"an estimate of {len(self.names)} objects with {fault}",
                "pose f64[N, 7], unit quaternions wxyz where seen; seen bool[N]; certainty f64[N], 0 to 1",
            )

    def _fault(self) -> str:
        """What is wrong with it, empty if nothing is; makes NumPy arrays of its fields."""
        for name, kinds in (("pose", "fiu"), ("seen", "b"), ("certainty", "fiu")):
            try:
                value = array_of(getattr(self, name))
            except (TypeError, ValueError):
                return f"`{name}` of unequal rows"
            if value.dtype.kind not in kinds:
                return f"`{name}` of {value.dtype}"
            if value.shape != (len(self.names), 7)[: 1 + (name == "pose")]:
                return f"`{name}` of shape {value.shape}"
            object.__setattr__(self, name, value)
        poses = self.pose[self.seen]
        if (
            not np.isfinite(poses).all()
            or (abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) > 1e-3).any()
        ):
            return f"poses {poses.tolist()}"
        if not ((self.certainty >= 0) & (self.certainty <= 1)).all():
            return f"certainty {self.certainty.tolist()}"
        return ""


class EpisodeView:
    """A running episode as its observers have it: cameras, and what the arm knows of itself. Read-only.

    Close it, or use it in a `with`, to give back what drawing takes.

    Args:
      execution: the simulation. names: of the scene's objects, in its order.
      seed: of the episode, for whatever an observer draws.
    """

    def __init__(self, execution: Execution, names: Sequence[str], seed: int = 0) -> None:
        self._execution = execution
        self.names = tuple(names)
        self.seed = seed
        self._renderer: Renderer | None = None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *told: Any) -> None:
        self._open.close()

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self._execution.num_steps * self._execution.step_time

    @property
    def joints(self) -> np.ndarray:
        """f64[7], radians."""
        return self._execution.joints

    @property
    def tool(self) -> np.ndarray:
        """f64[4, 4]: T_world_tool; `RobotDescription.gripper.tool` tells the hand's own frame."""
        return self._execution.tool

    @property
    def opening(self) -> float:
        """Metres that the fingers are from the middle, on average."""
        return self._execution.opening

    @property
    def is_closed(self) -> bool:
        """The fingers are told to close on something."""
        return self._execution.is_closed

    def picture(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """What a camera sees now, the arm included.

        Returns:
          u8[H, W, 3], and f32[H, W], metres along the optical axis, inf where nothing is.

        Raises:
          RendererError: nothing here can draw.
        """
        renderer = self._renderer_of(camera.width, camera.height)
        data = self._execution.data
        return renderer.average(data, camera, 1, _REACH), renderer.measure(data, camera)[0]

    def _renderer_of(self, width: int, height: int) -> Renderer:
        """A renderer of this size; one is open at a time."""
        if self._renderer is None or (self._renderer.width, self._renderer.height) != (
            width,
            height,
        ):
            self._open.close()
            model = self._execution.model
            set_range(
                model, _REACH * np.array([[-1, -1, 0], [1, 1, 1]]), CameraView(), width, height
            )
            self._renderer = self._open.enter_context(open_renderer(model, width, height))
        return self._renderer

    def true_poses(self, names: Sequence[str]) -> np.ndarray:
        """f64[n, 7]: T_world_object of these objects, for `TrueObserver` alone."""
        return self._execution.poses()[[self.names.index(name) for name in names]]


class Observer(Protocol):
    """Tells where things are, from what the robot's cameras see; `observer=` of `rearrange` takes it.

    An attribute `name` is what tables call it; `own_parts.part_label` says how its rows are told from
    those of others.
    """

    sees_held: bool
    """Whether it can be asked for one object, which may be in the hand, and not only for all."""

    def glance(self, world: EpisodeView) -> None:
        """Looks with the hand over the table; nothing but the arm moves until all names are asked for."""
        ...

    def __call__(
        self, world: EpisodeView, names: Sequence[str], known: np.ndarray
    ) -> SceneEstimate:
        """Where the objects of these names are now; called while nothing moves.

        Args:
          known: f64[n, 7], where they were seen, or where the hand should have put them; nan of what was
            never seen.
        """
        ...


class TrueObserver:
    """The true poses: what a perfect observer would tell."""

    name = "true poses"
    sees_held = True

    def glance(self, world: EpisodeView) -> None:
        """Not needed."""

    def __call__(
        self, world: EpisodeView, names: Sequence[str], known: np.ndarray
    ) -> SceneEstimate:
        number = len(names)
        return SceneEstimate(
            tuple(names),
            world.true_poses(names),
            np.ones(number, bool),
            np.ones(number, np.float64),
        )


class ObjectTracker:
    """Where objects are as far as is known: as last seen for sure; what the closed hand holds moves with it.

    Args:
      relook: False looks once, and then goes by what the hand has done.
      symmetry: of each object (`assets.symmetry.turn_symmetry`); none if not given.

    Attributes:
      num_looks: how often all objects were looked for.
    """

    def __init__(
        self,
        observer: Observer,
        view: EpisodeView,
        relook: bool = True,
        symmetry: Sequence[int] | None = None,
    ) -> None:
        self._observer = observer
        self._view = view
        self._relook = relook
        self._symmetry = symmetry or [1] * len(view.names)
        self.num_looks = 0
        self._looked_at = -1.0
        self._held = -1
        self._T_tool_object = np.eye(4)
        self._poses, self._guesses = np.full((2, len(view.names), 7), np.nan)
        # Of each object the latest moments that told the pose that is known, and another turn.
        self._agreed, self._turned = np.zeros((2, len(view.names)), int)

    @property
    def sees_held(self) -> bool:
        """The observer sees what is in the hand; else only the hand tells of it."""
        return self._observer.sees_held

    @property
    def poses(self) -> np.ndarray:
        """f64[N, 7]: what is known without another look; what is unseen is far below all else."""
        poses = self._poses.copy()
        poses[self.unseen] = _NOWHERE
        return poses

    @property
    def unseen(self) -> list[int]:
        """The numbers of the objects of which no estimate was believed so far."""
        return np.flatnonzero(np.isnan(self._poses[:, 0])).tolist()

    def guess(self) -> None:
        """Believes the latest estimate of what is unseen, if there is one, however unsure it is."""
        self._poses[self.unseen] = self._guesses[self.unseen]

    def __call__(self, only: int | None = None) -> np.ndarray:
        """f64[N, 7]: looks again, for one object or for all (`robot.motion.mover.See`); then as `poses`."""
        self._follow()
        # Nothing has happened since all was looked at.
        is_fresh = self._looked_at == self._view.time
        can_see = only is None or self._observer.sees_held
        if can_see and not is_fresh and (self._relook or not self.num_looks):
            asked = range(len(self._poses)) if only is None else (only,)
            found = self._observe(asked)
            told = zip(asked, found.pose, found.seen, found.certainty, strict=True)
            for number, pose, is_seen, certainty in told:
                if is_seen and self._is_believed(number, pose, certainty):
                    self._poses[number] = pose
                elif is_seen:
                    self._guesses[number] = pose
        return self.poses

    def take(self, number: int, T_tool_object: np.ndarray) -> None:
        """From the next closing of the hand on it holds an object, which then lies in it at f64[4, 4]."""
        self._held = number
        self._T_tool_object = T_tool_object
        self._agreed[number] = min(self._agreed[number], 1)
        self._turned[number] = 0

    def glance(self) -> None:
        """Has the observer look from here, for the next time that all objects are looked for."""
        if self._relook or not self.num_looks:
            self._observer.glance(self._view)

    def _is_believed(self, number: int, pose: np.ndarray, certainty: float) -> bool:
        """Whether an object is taken to be at a pose f64[7] from now on.

        Nothing turns round on the spot: where several moments have told how it stands, as many in a row must
        tell another turn, unless one is wholly certain.
        """
        known = self._poses[number]
        if np.isnan(known[0]):
            self._agreed[number] = 1
            return certainty >= AGREEING
        shift, turn = offset(matrix_of(pose), matrix_of(known), self._symmetry[number])
        if shift <= NEAR and turn <= NEAR_TURN:
            self._agreed[number] = min(self._agreed[number] + 1, _MOMENTS)
            self._turned[number] = 0
            return certainty >= AGREEING
        if certainty < OTHERWISE:
            return False
        if shift <= NEAR and certainty < 1:
            self._turned[number] += 1
            if self._turned[number] < self._agreed[number]:
                return False
        self._agreed[number] = 1
        self._turned[number] = 0
        return True

    def _observe(self, numbers: Sequence[int]) -> SceneEstimate:
        if len(numbers) == len(self._poses):
            self.num_looks = self.num_looks + 1
            self._looked_at = self._view.time
        names = [self._view.names[number] for number in numbers]
        found = self._observer(self._view, names, self._poses[list(numbers)])
        if not isinstance(found, SceneEstimate) or list(found.names) != names:
            told = found.names if isinstance(found, SceneEstimate) else type(found).__name__
            raise ConfigError(
                f"observer {part_name(self._observer)!r} returned {told!r}",
                f"a `SceneEstimate` of {', '.join(names)}",
            )
        return found

    def _follow(self) -> None:
        if self._view.is_closed and self._held >= 0:
            self._poses[self._held] = pose_of(self._view.tool @ self._T_tool_object)
