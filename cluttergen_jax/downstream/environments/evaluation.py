"""How often a policy succeeds in the scenes of a bank, by what is around the object that it is to move."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cluttergen_jax.downstream.environments.scripted import plan_actions
from cluttergen_jax.downstream.episodes.env import RobotEnv
from cluttergen_jax.downstream.episodes.starts import EpisodeStart
from cluttergen_jax.downstream.robot import episode_seed
from cluttergen_jax.downstream.robot.outcome import Outcome
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import gaps_in_plan
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import scene_cameras
from cluttergen_jax.sensing import FIRST_OBJECT, RaySensor, sensed_model
from cluttergen_jax.statistics import share_of
from cluttergen_jax.tables import aligned_table

Policy = Callable[[Mapping[str, Any]], np.ndarray]
"""From what is observed to an action. If it has a method `reset`, that is called before each episode."""
Bound = Literal["scripted", "random"]

NEAR = 0.10
"""Metres in plan from the target within which another object is its neighbour: half of a Panda's hand."""
_CAMERA = "front"
_WIDTH = 320
_HEIGHT = 240
_GROUPS: dict[str, tuple[tuple[str, float], ...]] = {
    "num_neighbours": (
        ("no neighbour within 10 cm", 1),
        ("1 neighbour", 2),
        ("2 or more", np.inf),
    ),
    "gap": (
        ("nearest within 2 cm", 0.02),
        ("2 to 5 cm", 0.05),
        ("farther", np.inf),
    ),
    "hidden": (
        ("less than a tenth hidden", 0.1),
        ("a tenth to a half", 0.5),
        ("more", np.inf),
    ),
}
"""Of each measure the groups, with the value that they end before."""


@dataclass(frozen=True)
class PolicyEpisode:
    """One episode of an evaluation.

    Attributes:
      scene: its number in the bank. target: the name of the object that is to be moved.
      outcome: as the environment's `info` has it, "" where a planner gave up. num_steps: of control.
      num_neighbours: objects less than 10 cm from the target in plan, as boxes.
      gap: metres in plan from it to the nearest other object, as boxes; inf without one.
      hidden: the share of it, 0 to 1, that other objects hide from the camera `front`.
    """

    scene: int
    target: str
    outcome: str
    num_steps: int
    num_neighbours: int
    gap: float
    hidden: float

    @property
    def is_success(self) -> bool:
        """Whether it ended in success."""
        return self.outcome == Outcome.SUCCESS


@dataclass(frozen=True)
class PolicyEvaluation:
    """Episodes of one policy, in the order in which they were run; printed, a table of how many succeed."""

    episodes: tuple[PolicyEpisode, ...]

    @property
    def num_successes(self) -> int:
        """Of all episodes."""
        return sum(each.is_success for each in self.episodes)

    @property
    def groups(self) -> dict[str, tuple[PolicyEpisode, ...]]:
        """All episodes, and those of each group by neighbours, gap and hidden share that there are any of."""
        found = {"all": self.episodes}
        for measure, limits in _GROUPS.items():
            ends = [end for _, end in limits]
            values = [getattr(each, measure) for each in self.episodes]
            places = np.searchsorted(ends[:-1], values, side="right")
            for place, (label, _) in enumerate(limits):
                group = [
                    each for each, own in zip(self.episodes, places, strict=True) if own == place
                ]
                if group:
                    found[label] = tuple(group)
        return found

    def __str__(self) -> str:
        """Shares of success with their 95 % intervals (Wilson)."""
        rows = [
            (label, share_of(sum(each.is_success for each in group), len(group)))
            for label, group in self.groups.items()
        ]
        return aligned_table(("", "success"), rows)


def evaluate(
    env: RobotEnv, policy: Policy | Bound, scenes: Sequence[int] | None, seed: int
) -> PolicyEvaluation:
    """See `evaluate_policy`."""
    if not isinstance(env, RobotEnv):
        raise ConfigError(f"evaluate_policy({env!r})", "an environment of make_env")
    if not callable(policy) and policy not in ("scripted", "random"):
        raise ConfigError(
            f"policy = {policy!r}", "a function of what is observed, 'scripted' or 'random'"
        )
    asked = env.scenes if scenes is None else list(scenes)
    if not asked:
        raise ConfigError("an evaluation in no scene", "one or more", "scenes=None, all")
    view = TargetView()
    found = []
    good = 0
    with Progress("evaluation", len(asked), "episode") as progress:
        for number, scene in enumerate(asked):
            drawn = episode_seed(seed, number)
            seen, _ = env.reset(seed=drawn, options={"scene": scene})
            assert env.start is not None
            around = clutter_of(env, env.start, view)
            start = env.saved_start
            outcome, num_steps = _run(env, policy, seen, drawn)
            episode = PolicyEpisode(start.scene, start.target, outcome, num_steps, *around)
            found.append(episode)
            good += episode.is_success
            progress.update(note=f"{good} good")
    return PolicyEvaluation(tuple(found))


def _run(
    env: RobotEnv, policy: Policy | Bound, seen: Mapping[str, Any], seed: int
) -> tuple[str, int]:
    """Runs the episode that `env` has just begun; its outcome and number of steps.

    Where the planner of the scripted policy finds no way on it ends there, with the outcome "".
    """
    planned = plan_actions(env, seed) if policy == "scripted" else None
    env.action_space.seed(seed)
    if (reset := getattr(policy, "reset", None)) is not None:
        reset()
    num_steps = 0
    action: Any
    while True:
        if planned is not None:
            action = next(planned, None)
            if action is None:
                return "", num_steps
        elif callable(policy):
            action = policy(seen)
        else:
            action = env.action_space.sample()
        seen, _, terminated, truncated, info = env.step(action)
        num_steps += 1
        if terminated or truncated:
            return info["outcome"], num_steps


def clutter_of(env: RobotEnv, start: EpisodeStart, view: TargetView) -> tuple[int, float, float]:
    """Neighbours, gap and hidden share of the target, where the hand has to find it or bring it."""
    target = start.target
    poses = np.array(start.scene.poses, np.float64)
    if not env.task_kind.has_goals:
        # What is to be placed comes among the others; what is to be grasped has its own pose for a goal.
        poses[target] = start.goals[target]
    half = np.array([each.half_extents for each in start.scene.objects])
    apart = np.delete(gaps_in_plan(half, poses)[target], target)
    gap = float(apart.min()) if len(apart) else float("inf")
    return int((apart < NEAR).sum()), gap, view.hidden(start, poses)


class TargetView:
    """What other objects hide of the target from a camera that stands still; its last model is kept."""

    def __init__(self) -> None:
        self._names: tuple[str, ...] | None = None

    def hidden(self, start: EpisodeStart, poses: np.ndarray) -> float:
        """The share, at poses f64[N, 7]; 0 of what the camera would not see in any case."""
        scene = start.scene
        if scene.names != self._names:
            self._sensor = RaySensor(sensed_model(scene.objects, scene.support))
            self._data = self._sensor.make_data()
            self._names = scene.names
        fixed = scene_cameras(scene.support, (_CAMERA,))[0]
        camera = replace(fixed, width=_WIDTH, height=_HEIGHT).pinhole
        is_target = np.arange(len(poses)) == start.target
        counts = []
        for is_there in (np.ones_like(is_target), is_target):
            self._sensor.pose(self._data, poses, is_there)
            label = self._sensor.sense(self._data, camera).label
            counts.append(int((label == FIRST_OBJECT + start.target).sum()))
        seen, whole = counts
        return 1 - seen / whole if whole else 0.0
