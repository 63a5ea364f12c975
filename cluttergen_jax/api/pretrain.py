"""Pretraining of a point encoder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import Encoder
from cluttergen_jax.numerics import with_kept_programs

if TYPE_CHECKING:
    from cluttergen_jax.learning.training.pretrain import PretrainReport


@with_kept_programs
def pretrain(
    encoder: Encoder = "pointnet2",
    out: str | Path | None = None,
    *,
    features: int | None = None,
    object_points: int = 512,
    num_centroids: int = 128,
    group_size: int = 16,
    num_shapes: int = 16,
    num_held_out: int = 4,
    num_epochs: int = 20,
    batch_size: int = 32,
    learning_rate: float = 1e-3,
    seed: int = 0,
) -> PretrainReport:
    """Pretrains a point encoder by classifying shapes (`cluttergen pretrain`).

    The classes are the families of the modeller (those of the five pools), each with many objects of drawn
    proportions. The same call resumes an interrupted run.

    Args:
      encoder: "pointnet2" (the paper's), "pointnet", or "set" (the small one of the set encoder).
      out: the run's folder; runs/encoder-ENCODER if not given.
      features: of the encoder; 64 for "set" and 1,024 for the others if not given.
      object_points: of each cloud; at most 1,024 are used in training.
      num_centroids: of the first level of PointNet++.
      group_size: points around each of them.
      num_shapes: objects of each family to learn from.
      num_held_out: objects of each family to test with.
      num_epochs: times that all of the former are seen.
      batch_size: shapes per step.
      learning_rate: of Adam, at first.
      seed: of shapes, weights and their order.

    Returns:
      The folder, which `encoder_weights` of `train` takes, and the accuracy on what was held out.

    Raises:
      ConfigError: a setting is out of range, or the folder holds a run with other settings.
      BankError: another process writes to `out`.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    from cluttergen_jax.learning.ppo.checkpoint import hold_run
    from cluttergen_jax.learning.training.pretrain import (
        PretrainConfig,
        Pretraining,
        PretrainReport,
        small,
    )

    sizes = small(encoder)
    if features is not None:
        sizes = replace(sizes, object_features=features, scene_features=features)
    config = PretrainConfig(
        replace(
            sizes, object_points=object_points, num_centroids=num_centroids, group_size=group_size
        ),
        num_shapes=num_shapes,
        num_held_out=num_held_out,
        num_epochs=num_epochs,
        batch_size=batch_size,
        learning_rate=learning_rate,
        seed=seed,
    )
    folder = Path(out or f"runs/encoder-{encoder}")
    with hold_run(folder):
        accuracy = Pretraining(config, folder).run()
    return PretrainReport(
        folder, accuracy, num_held_out * len(config.families), len(config.families)
    )
