"""Scenes made by hand, in a browser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import Containment, Overhang, check_range
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.spec import SceneSpec

if TYPE_CHECKING:
    from cluttergen_jax.assets.support import Rectangle
    from cluttergen_jax.generation.generate import GeneratedBank

_MOST = 2**32 - 1


@with_own_settings
def place_by_hand(
    out: str | Path = "out/hand",
    *,
    pool: str | Path = "dining",
    num_objects: int | None = None,
    objects: Sequence[str] = (),
    exclude: Sequence[str] = (),
    support: str | Path = "table",
    region: Rectangle | str | None = None,
    containment: Containment = "center",
    keep_out: Sequence[Rectangle | str] = (),
    min_margin: float | None = None,
    overhang: Overhang = "any",
    repeat: bool = False,
    seed: int = 0,
    overwrite: bool = False,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    show: Callable[[str], None] = print,
) -> GeneratedBank:
    """Has a person place objects in a browser until Ctrl-C, and keeps the scenes (`cluttergen view --place`).

    Each object is dragged and turned, lowered to first contact and let go; the attempt is judged by the rules
    that methods obey, as often as the person likes. A scene is kept as soon as it is saved or given up, in a
    bank of method "hand" whose column `seconds` tells what it took; the same call adds scenes to it.

    Args:
      out: the bank's folder, or a URL; a hand-made bank with the same settings is continued.
      pool: a pool's name or folder, or several joined by +: dining+mine.
      num_objects: objects per scene; all of the pool's (40 at most) if not given.
      objects: names of the pool's objects to use; all of them if empty.
      exclude: names of the pool's objects to leave out.
      support: a support's name or folder; "table-0.40x0.50" is a cuboid of that size.
      region: the queried region, WxD or X,Y,W,D[,YAW] in metres and degrees; the support's own if not given.
        In Python also a `Rectangle`.
      containment: what must lie in the region: the bounding box's "center", or its whole "footprint".
      keep_out: boxes that objects must stay out of, X,Y,W,D[,YAW] each; in Python also `Rectangle`s.
      min_margin: metres that the centre of mass of what is placed must lie inside its support, in plan; 0
        asks for nothing. If not given: 0.003.
      overhang: how much of an object may reach beyond the support's edge once it rests: "any", "half" or
        "none".
      repeat: allow duplicates: an object may be placed more than once.
      seed: draws each scene's objects, 0 to 4294967295.
      overwrite: begin anew if the folder holds another bank.
      host: the address to listen on; 0.0.0.0 lets other machines in, if they have the token.
      port: 0 takes any free one.
      browser: open a browser.
      show: is given the lines that tell where the panel is, and what was kept.

    Returns:
      The bank; printed, it tells how well it went.

    Raises:
      ConfigError, PoolError: as `make_sampler`; or the port is taken.
      BankError: the folder holds something else, cannot be written, or is being written by another process.
      MissingExtraError: the extra `viewer` is not installed.
    """
    from cluttergen_jax.generation.hand import HandBank, hand_setup
    from cluttergen_jax.generation.sources.viewing import place_web

    check_range("seed", seed, 0, _MOST, 0)
    spec = SceneSpec(
        pool=pool,
        objects=objects,
        exclude=exclude,
        num_objects=num_objects,
        repeat=repeat,
        support=support,
        region=region,
        keep_out=keep_out,
        containment=containment,
        min_margin=min_margin,
        overhang=overhang,
        engine="native",
    )

    def open_bank() -> HandBank:
        return HandBank(out, hand_setup(spec), spec.boxes(), seed, overwrite)

    return place_web(open_bank, host, port, browser, show)
