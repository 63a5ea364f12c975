"""Weights & Biases, for those who use it: the optional extra `wandb`."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.learning.training.metrics_log import Row

PROJECT = "cluttergen"


class WandbLog:
    """A `metrics_log.Sink` that sends every row to Weights & Biases.

    A run that is taken up again goes on where it was: its id is made from its folder.

    Args:
      folder: of the run; its name is the run's.
      recipe: JSON values that describe the run.

    Raises:
      MissingExtraError: wandb is not installed.
    """

    def __init__(self, folder: Path, recipe: dict[str, Any]) -> None:
        try:
            import wandb
        except ImportError as error:
            raise MissingExtraError("wandb", "`wandb`") from error
        identity = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
        self._run = wandb.init(
            project=PROJECT,
            name=folder.name,
            id=identity,
            resume="allow",
            dir=str(folder),
            config=recipe,
        )

    def add(self, row: Row, group: str) -> None:
        """See `metrics_log.Sink.add`; the step is the number of attempts."""
        self._run.log({group + name: value for name, value in row.items()}, step=int(row["attempts"]))

    def close(self) -> None:
        """See `metrics_log.Sink.close`."""
        self._run.finish()
