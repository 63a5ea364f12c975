"""The words that settings of downstream take, and their limits."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Real
from typing import Any, Literal, get_args

from cluttergen_jax.errors import ConfigError

Split = Literal["train", "val", "test"]
PlacerHead = Literal["scored"]
PlacerNoise = Literal["on", "off", "both"]
SensedFrom = Literal["free", "overhead", "side"]
RobotTask = Literal["lift", "place"]
RobotCamera = Literal["overhead", "front", "side", "wrist", "hand"]
RobotEnvTask = Literal["place", "rearrange", "grasp"]
Rearrangement = Literal["paper", "occupied", "blocked", "eight", "stacked"]
LayoutRule = Literal["clearance", "reach", "similar"]
PickOrder = Literal["graph", "lowest"]
RobotObserver = Literal["true", "perception"]
RecordFormat = Literal["lerobot", "robomimic"]
RobotPhysics = Literal["accurate", "learning"]
MjxTask = Literal["grasp", "place"]
MjxImpl = Literal["auto", "warp", "jax"]
RobotReward = Literal["dense", "sparse"]
RenderMode = Literal["rgb_array"]
GraspRule = Literal["vgn", "strict"]
PadSource = Literal["scene", "model", "robosuite", "maniskill"]
GraspFormat = Literal["vgn", "giga", "acronym", "contact_graspnet", "graspnet"]

ENV_IDS: dict[str, RobotEnvTask] = {
    "cluttergen/Place-v1": "place",
    "cluttergen/Grasp-v1": "grasp",
    "cluttergen/Rearrange-v1": "rearrange",
}
"""Task of `robot.make_env` by id of Gymnasium."""

MAX_PAIRS = 10_000_000
"""Of a split of a data set: a larger number is a slip of the hand."""

MAX_NOISE = 10.0
"""Times the noise of a usual depth camera."""


def check_choice(name: str, value: object, words: Any) -> None:
    """Refuses what is none of the words of a `Literal` (ConfigError)."""
    if value not in get_args(words):
        raise ConfigError(f"{name} = {value!r}", ", ".join(get_args(words)))


def check_factor(noise: Any) -> None:
    """Refuses what is no factor of the usual noise (ConfigError)."""
    if not (isinstance(noise, Real) and 0 <= float(noise) <= MAX_NOISE):
        raise ConfigError(f"noise = {noise!r}", f"0 to {MAX_NOISE:g}", "noise=1")


def check_noise(noise: object) -> None:
    """Refuses what is no sequence of factors of the usual noise (ConfigError)."""
    factors = list(noise) if isinstance(noise, Iterable) and not isinstance(noise, str) else []
    if not factors or not all(
        isinstance(each, Real) and 0 <= float(each) <= MAX_NOISE for each in factors
    ):
        raise ConfigError(
            f"noise = {noise!r}", f"one number or more, 0 to {MAX_NOISE:g}", "noise=(0, 1)"
        )
