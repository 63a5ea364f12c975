"""Scenes made by hand, in a browser."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.config import check_range
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.placement.methods.table import TARGETS
from cluttergen_jax.spec import SceneOptions, spec_of, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.generation.generate import GeneratedBank

_MOST = 2**32 - 1
_PERSON = "where a person places"
_NOT_TAKEN = {
    **dict.fromkeys(("method", "checkpoint", "height", "poses", *TARGETS, "clearance"), _PERSON),
    **dict.fromkeys(
        ("order", "max_attempts", "ruin_after", "budget"), f"{_PERSON}, as often as wanted"
    ),
    **dict.fromkeys(
        ("shelf", "weights", "balance", "surface", "start"), "where one world is opened"
    ),
    **dict.fromkeys(
        ("robust", "for_engine", "setting", "stability"), "where the usual check is made"
    ),
    **dict.fromkeys(
        ("engine", "num_threads"), "where the native engine judges one attempt at a time"
    ),
}
"""Fields of a `SceneSpec` that placing by hand does not take, and why."""


@with_kept_programs
@takes_spec(_NOT_TAKEN)
def place_by_hand(
    out: str | Path = "out/hand",
    *,
    seed: int = 0,
    overwrite: bool = False,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    show: Callable[[str], None] = print,
    **options: Unpack[SceneOptions],
) -> GeneratedBank:
    """Has a person place objects in a browser until Ctrl-C, and keeps the scenes (`cluttergen view --place`).

    Each object is dragged and turned, lowered to first contact and let go; the attempt is judged by the rules
    that methods obey, as often as the person likes. A scene is kept as soon as it is saved or given up, in a
    bank of method "hand" whose column `seconds` tells what it took; the same call adds scenes to it. The
    arguments that are not explained here are those of `SceneSpec`.

    Args:
      out: the bank's folder, or a URL; a hand-made bank with the same settings is continued.
      seed: draws each scene's objects, 0 to 4294967295.
      overwrite: begin anew if the folder holds another bank.
      host: the address to listen on; 0.0.0.0 lets other machines in, if they have the token.
      port: 0 takes any free one.
      browser: open a browser.
      show: is given the lines that tell where the panel is, and what was kept.
      options: fields of `SceneSpec`.

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
    spec = replace(spec_of(place_by_hand, None, options), engine="native")

    def open_bank() -> HandBank:
        return HandBank(out, hand_setup(spec), spec.boxes(), seed, overwrite)

    return place_web(open_bank, host, port, browser, show)
