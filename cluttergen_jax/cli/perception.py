"""`cluttergen perception`: views, segmenters, and how well objects and their poses are found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.downstream.perception.api import (
    perception_data,
    perception_eval,
    perception_train,
)


@options_from(perception_data)
class PerceptionData(Options):
    """Render views of scenes to train and judge perception with. Rerun to resume.

    Example: `cluttergen perception data --pool household --num-views 6000 --out views`
    """

    def run(self) -> int:
        views = self.call(perception_data)
        for split in views.splits:
            print(f"views      {views.split(split)['num_views']} of {split} in {views.path}")
        return 0


@options_from(perception_train, data=Annotated[str, tyro.conf.Positional])
class PerceptionTrain(Options):
    """Train a segmenter on views. Rerun to resume.

    Example: `cluttergen perception train views --out runs/segmenter`
    """

    def run(self) -> int:
        self.call(perception_train)
        return 0


@options_from(perception_eval, data=Annotated[str, tyro.conf.Positional])
class PerceptionEval(Options):
    """Judge masks, poses and certainty against what is true (extra `perception`).

    Every row is kept in the folder `--out`: rerun to resume.

    Example: `cluttergen perception eval views --segmenter runs/segmenter`
    """

    def run(self) -> int:
        print(self.call(perception_eval, out=self.out or "out/perception"))
        return 0


@dataclass(frozen=True)
class Perception:
    """Known objects in images: `perception data`, `perception train` and `perception eval`.

    Example: `cluttergen perception data --num-views 6000 --out views`

    Attributes:
      action: what to do.
    """

    action: (
        Annotated[PerceptionData, tyro.conf.subcommand("data")]
        | Annotated[PerceptionTrain, tyro.conf.subcommand("train")]
        | Annotated[PerceptionEval, tyro.conf.subcommand("eval")]
    )

    def run(self) -> int:
        return self.action.run()
