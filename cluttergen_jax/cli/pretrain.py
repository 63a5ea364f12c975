"""`cluttergen pretrain`: a point encoder that tells shapes apart, for `train --encoder-weights`."""

from __future__ import annotations

from dataclasses import dataclass

from cluttergen_jax.cli.parse import keywords
from cluttergen_jax.config import Encoder


@dataclass(frozen=True)
class Pretrain:
    """Pretrain a point encoder by classifying shapes. The same command takes an interrupted run up again.

    The classes are the families of the modeller (those of the five pools), each with many objects of drawn
    proportions; accuracy is that on objects that were not learned from.

    Example: `cluttergen pretrain --encoder pointnet2`

    Attributes:
      encoder: pointnet2 (the paper's), pointnet, or set (the small one of the set encoder).
      out: the run's folder; runs/encoder-ENCODER if not given.
      features: of the encoder; 64 for set and 1,024 for the others if not given.
      object_points: of each cloud; at most 1,024 are used in training.
      num_centroids: of the first level of PointNet++.
      group_size: points around each of them.
      num_shapes: objects of each family to learn from.
      num_held_out: objects of each family to test with.
      num_epochs: times that all of the former are seen.
      batch_size: shapes per step.
      learning_rate: of Adam, at first.
      seed: of shapes, weights and their order.
    """

    encoder: Encoder = "pointnet2"
    out: str | None = None
    features: int | None = None
    object_points: int = 512
    num_centroids: int = 128
    group_size: int = 16
    num_shapes: int = 16
    num_held_out: int = 4
    num_epochs: int = 20
    batch_size: int = 32
    learning_rate: float = 1e-3
    seed: int = 0

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.learning.training.pretrain import pretrain

        print(f"run        {self.out or f'runs/encoder-{self.encoder}'}")
        report = pretrain(**keywords(self))
        found = f"{report.accuracy:.3f} of {report.num_held_out} shapes of {report.num_families} families"
        print(f"held out   {found} recognised")
        print(f"done       --encoder {self.encoder} --encoder-weights {report.folder}")
        return 0
