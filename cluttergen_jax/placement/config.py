"""What is asked of an episode: how many objects, how often to try, where, and what it pays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from cluttergen_jax.config import Containment, Order, Reward
from cluttergen_jax.errors import ConfigError, closest

MAX_SLOTS = 40
MAX_ATTEMPTS = 10
CONTAINMENTS, ORDERS, REWARDS = get_args(Containment), get_args(Order), get_args(Reward)


@dataclass(frozen=True)
class PlacementConfig:
    """One episode of the decision process (paper, section 3).

    Attributes:
      num_objects: slots to fill.
      max_attempts: attempts per object (paper: 5).
      containment: what must lie in the queried region once settled: the bounding box's "center" or the
        whole "footprint".
      order: "random" draws a fresh uniform permutation of a uniform subset each episode; "fixed" takes the
        world's objects in their order.
      reward: "paper" (its equation 1), "code" (what its published code pays) or "compressed".
      history_stride: keep every so many rows of a failed attempt's trajectory, release first; 0 remembers no
        attempt at all, which is faster for methods that never look back.
      motion_cost: c of the paper's equation 1.
      success_reward: R0 of the paper's equation 1.
    """

    num_objects: int = 10
    max_attempts: int = 5
    containment: str = "center"
    order: str = "random"
    reward: str = "paper"
    history_stride: int = 1
    motion_cost: float = 0.005
    success_reward: float = 100.0

    def __post_init__(self) -> None:
        if not 1 <= self.num_objects <= MAX_SLOTS:
            raise ConfigError(f"num_objects = {self.num_objects}", f"1 to {MAX_SLOTS}")
        if not 1 <= self.max_attempts <= MAX_ATTEMPTS:
            raise ConfigError(f"max_attempts = {self.max_attempts}", f"1 to {MAX_ATTEMPTS}", "5")
        if not 0 <= self.history_stride <= 240:
            raise ConfigError(f"history_stride = {self.history_stride}", "0 to 240", "1, or 12 on a CPU")
        for name, value, allowed in (
            ("containment", self.containment, CONTAINMENTS),
            ("order", self.order, ORDERS),
            ("reward", self.reward, REWARDS),
        ):
            if value not in allowed:
                raise ConfigError(
                    f"{name} = {value!r}",
                    ", ".join(allowed),
                    f"{name}={allowed[0]!r}",
                    closest(value, allowed),
                )
