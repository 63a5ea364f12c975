"""`cluttergen rearrange`: a simulated arm brings objects into one of several new layouts."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import tyro

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.downstream.rearrange.api import rearrange
from cluttergen_jax.downstream.words import RobotObserver


@options_from(
    rearrange,
    bank=Annotated[str | None, tyro.conf.Positional],
    observer=RobotObserver,
    grasps=str | None,
    target=str | None,
    robot=str,
)
class Rearrange(Options):
    """Let a simulated robot arm rearrange the objects of scenes (extra `robot`).

    Example: `cluttergen rearrange --setting blocked --num-episodes 20`
    """

    def run(self) -> int:
        # Whoever reads the address from a pipe waits for it.
        print(self.call(rearrange, show=partial(print, flush=True)))
        return 0
