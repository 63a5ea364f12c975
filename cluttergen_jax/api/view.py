"""Scenes in a browser, or in MuJoCo's own viewer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cluttergen_jax.config import Method
from cluttergen_jax.numerics import with_kept_programs


@with_kept_programs
def view(
    source: str | Path | None = None,
    *,
    pool: str | Path | None = None,
    method: Method | None = None,
    num_objects: int | None = None,
    support: str | Path | None = None,
    native: bool = False,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    screenshots: str | Path = "out/screenshots",
    show: Callable[[str], None] = print,
) -> None:
    """Shows scenes in a browser until Ctrl-C, or in a window until it is closed (`cluttergen view`).

    Args:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes. Without it, `method` makes them from `pool`.
      pool: a pool's name or folder to sample from where no bank says it; a checkpoint's own if one is given.
      method: as `generate` takes it; the checkpoint's own, else "drop".
      num_objects: all of the pool's (40 at most) if not given.
      support: a support's name or folder; a checkpoint's own, else the paper's table.
      native: open MuJoCo's own viewer instead (needs a screen).
      host: the address to listen on; 0.0.0.0 lets other machines look, if they have the token.
      port: 0 takes any free one.
      browser: open a browser.
      screenshots: the folder for screenshots.
      show: is given the lines that tell where the viewer is.

    Raises:
      PoolError, BankError, AssetError: there is nothing of the kind, or it cannot be read.
      ConfigError: the port is taken, or there is no such method.
      MissingExtraError: the extra `viewer` is not installed.
      DisplayError: there is no screen for `native`.
    """
    from cluttergen_jax.generation.sources import LiveConfig
    from cluttergen_jax.generation.sources.viewing import view_native, view_web

    live = LiveConfig(
        None if pool is None else str(pool),
        method,
        num_objects,
        None if support is None else str(support),
    )
    text = None if source is None else str(source)
    if native:
        view_native(text, live, show)
    else:
        view_web(text, live, host, port, browser, Path(screenshots), show)
