"""`cluttergen placer`: pairs for stable placement, and placers side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.downstream.placer.api import placer_data, placer_eval, placer_train
from cluttergen_jax.errors import ConfigError


@options_from(placer_data, bank=Annotated[str | None, tyro.conf.Positional])
class PlacerData(Options):
    """Make pairs to learn stable placement from. Rerun to resume.

    A pair is one depth image of the first objects of a scene, the true pose of the next object, and 32
    labelled candidate poses.

    Example: `cluttergen placer data --num-scenes 500 --pool household --out pairs`
    """

    def run(self) -> int:
        pairs = self.call(placer_data)
        for split in pairs.splits:
            print(f"pairs      {pairs.split(split)['num_pairs']} of {split} in {pairs.path}")
        return 0


@options_from(placer_train, data=Annotated[tuple[str, ...], tyro.conf.Positional])
class PlacerTrain(Options):
    """Train a placer on pairs. Rerun to resume.

    Example: `cluttergen placer train pairs --head scored --out runs/placer`
    """

    def run(self) -> int:
        if not self.data:
            raise ConfigError("no folder of pairs", "one or more", "cluttergen placer train pairs")
        self.call(placer_train)
        return 0


@options_from(placer_eval, data=Annotated[str, tyro.conf.Positional], placers=tuple[str, ...])
class PlacerEval(Options):
    """Compare placers: the success rate of their proposals, strictly judged.

    Every row is kept under `results` in the folder `--out`: rerun to resume.

    Example: `cluttergen placer eval pairs --placers random geometry --noise 0 1`
    """

    def run(self) -> int:
        print(self.call(placer_eval, out=self.out or "out/placer"))
        return 0


@dataclass(frozen=True)
class Placer:
    """Stable placement from one camera's view: `placer data`, `placer train` and `placer eval`.

    Example: `cluttergen placer data --num-scenes 500 --pool household --out pairs`

    Attributes:
      action: what to do.
    """

    action: (
        Annotated[PlacerData, tyro.conf.subcommand("data")]
        | Annotated[PlacerTrain, tyro.conf.subcommand("train")]
        | Annotated[PlacerEval, tyro.conf.subcommand("eval")]
    )

    def run(self) -> int:
        return self.action.run()
