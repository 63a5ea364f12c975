"""`cluttergen generate`: a bank of scenes, with progress, a summary, and files to look at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.parse import keywords
from cluttergen_jax.config import Containment, Engine, Method, Order
from cluttergen_jax.placement.config import MIN_MARGIN


@dataclass(frozen=True)
class Generate:
    """Generate verified cluttered scenes and save them as a bank.

    Example: `cluttergen generate --pool dining --num-scenes 100 --out bank`

    Attributes:
      out: the bank's folder; the same command continues an interrupted one.
      pool: a pool's name or folder (`cluttergen list`), or several joined by +: dining+mine.
      num_scenes: scenes to make, failures counted.
      method: how poses are proposed: random, clear, drop, or a trained policy: policy, policy-clear, ranked,
        beta, normal, open_loop or short_memory. If not given: the checkpoint's own; else policy where one
        is embedded for this pool, support and number of objects that fills nine of ten scenes, else clear.
      checkpoint: the policy's folder; the embedded one for the pool if not given.
      num_objects: objects per scene; all of the pool's (40 at most) if not given.
      objects: names of the pool's objects to use.
      exclude: names of the pool's objects to leave out; --exclude mug is the same as --pool dining~mug.
      support: a support's name or folder; table-0.40x0.50 is a cuboid of that size.
      region: the queried region, WxD or X,Y,W,D[,YAW] in metres and degrees; the support's own if not given.
      containment: what must lie in the region: the bounding box's center, or its whole footprint.
      order: random, or fixed to the pool's order.
      attempts: attempts per object.
      min_margin: metres that the centre of mass of what is placed must lie inside its support, in plan; 0
        asks for nothing, as the paper does.
      repeat: let objects stand there more than once.
      start: a scene to start from, BANK:INDEX; its objects stay and count as neighbours.
      keep_out: boxes that objects must stay out of, X,Y,W,D[,YAW] each.
      seed: the same seed makes the same scenes.
      engine: auto, native, warp or jax.
      threads: simulation threads; 0 takes every core.
      render: draw a picture of each scene that gets a file (--no-render to skip).
      max_files: the first so many scenes get an MJCF file each (and a picture) if they succeed.
      overwrite: begin anew if the folder holds another bank.
    """

    out: str = "out"
    pool: str = "dining"
    num_scenes: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 20
    method: Method | None = None
    checkpoint: str | None = None
    num_objects: int | None = None
    objects: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    support: str = "table"
    region: str | None = None
    containment: Containment = "center"
    order: Order = "random"
    attempts: int = 5
    min_margin: float = MIN_MARGIN
    repeat: bool = False
    start: str | None = None
    keep_out: tuple[str, ...] = ()
    seed: int = 0
    engine: Engine = "auto"
    threads: int = 0
    render: bool = True
    max_files: int = 1000
    overwrite: bool = False

    def run(self) -> int:
        """Runs the command; the exit status."""
        from cluttergen_jax.generation.generate import generate

        print(with_flags(str(generate(**keywords(self))), Generate))
        return 0
