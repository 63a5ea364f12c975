"""Sizes of the network that proposes poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

from cluttergen_jax.config import Encoder
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.networks.distributions import HEADS
from cluttergen_jax.placement.clouds import MAX_POINTS

KIND = "pose"
"""Of these networks, as a checkpoint's record names it."""
MIXTURE = "mixture"
SCENE_ENCODERS = get_args(Encoder)
_POSITIVE = ("object_points", "object_features", "scene_features", "num_centroids", "group_size")


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network that proposes poses.

    Attributes:
      head: "beta_free" (the paper's, as its code has it), "beta" (with one mode inside the region), "normal"
        or "mixture" (of Betas, over the cells of a grid of heights).
      num_cells, num_turns: of the mixture: cells along each side of the queried region, ranges of turns.
      turn_symmetry: of objects, as a mixture sees them: 2 if half a turn is to make no difference (a range of
        turns is also its opposite), 1 if it is (a pan's handle lies on one side).
      undersides: whether a mixture is told that what is lower than the object's underside is not in its way.
      room: whether a mixture is told how much of the object's footprint would lie over other objects, and
        beyond the region, at each cell and turn.
      height_precision: where z of "beta" and "normal" begins: 0 anywhere in its range, as in the paper; else
        about the height at which the object would rest on the bare top, as narrow as a Beta of this
        concentration.
      height_clearance: how far above that, metres.
      scene_encoder: "set" attends over the placed objects (their features, sizes and poses); "pointnet" and
        "pointnet2" (the paper's) read the scene's point cloud, made again from the poses. Either of the two
        reads the cloud of the current object as well; beside "set" that is a small PointNet.
      object_points: points of each object's cloud that are read.
      object_features: F of the encoder of objects.
      scene_points: points of the scene's cloud (paper: 20,480).
      scene_features: of its encoder (paper: 1,024).
      num_centroids: of the first level of PointNet++, at most half of the points; the second has a quarter.
      group_size: points around each of them; the second level takes twice as many.
      encoder_frozen: the weights of the point encoders come from `cluttergen pretrain` and stay as they are.
      token_width, num_heads: of the set encoder.
      history_width: of the three layers that read failed attempts; 0 reads none (variant `open_loop`).
      history_length: how many of the latest attempts are read (variant `short_memory`: 1).
      num_layers, width: of actor and critic, before the output (paper: 4 of 256, its five with the output).
    """

    head: str = "beta"
    num_cells: int = 20
    num_turns: int = 8
    turn_symmetry: int = 2
    undersides: bool = False
    room: bool = True
    height_precision: float = 0.0
    height_clearance: float = 0.002
    scene_encoder: str = "set"
    object_points: int = 64
    object_features: int = 64
    scene_points: int = 2048
    scene_features: int = 256
    num_centroids: int = 128
    group_size: int = 16
    encoder_frozen: bool = False
    token_width: int = 96
    num_heads: int = 4
    history_width: int = 128
    history_length: int = 5
    num_layers: int = 5
    width: int = 256

    def __post_init__(self) -> None:
        if self.head not in (*HEADS, MIXTURE):
            raise ConfigError(f"head {self.head!r}", ", ".join((*HEADS, MIXTURE)), "head beta")
        if self.head == "beta_free" and self.height_precision:
            raise ConfigError(
                f"height_precision = {self.height_precision} with head beta_free", "0", "head beta"
            )
        if self.scene_encoder not in SCENE_ENCODERS:
            raise ConfigError(f"scene_encoder {self.scene_encoder!r}", ", ".join(SCENE_ENCODERS))
        for name in _POSITIVE:
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}", "a positive number")
        if self.turn_symmetry not in (1, 2):
            raise ConfigError(f"turn_symmetry = {self.turn_symmetry}", "1 or 2")
        if not 64 <= self.scene_points <= MAX_POINTS:
            raise ConfigError(f"scene_points = {self.scene_points}", f"64 to {MAX_POINTS}")

    @property
    def num_cells_read(self) -> int:
        """Cells along each side of the height grid that observations must hold; 0 if none is read."""
        return self.num_cells if self.head == MIXTURE else 0

    @property
    def reads_room(self) -> bool:
        """Whether observations are to hold the room for the current object."""
        return self.room and self.head == MIXTURE

    @property
    def reads_clouds(self) -> bool:
        """Whether the scene is seen as a point cloud."""
        return self.scene_encoder != "set"

    def with_attempts(self, number: int) -> NetworkConfig:
        """The full method looks back on every attempt that an object may have, however many those are."""
        return replace(self, history_length=number) if self.history_length > 1 else self
