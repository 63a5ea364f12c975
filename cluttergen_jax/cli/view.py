"""`cluttergen view`: scenes in a browser, or in MuJoCo's own viewer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import tyro

from cluttergen_jax.cli.parse import keywords
from cluttergen_jax.config import Method


@dataclass(frozen=True)
class View:
    """Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.

    Example: `cluttergen view out`, or `cluttergen view --pool dining --method drop`

    Attributes:
      source: a bank; one scene of it, BANK:INDEX or BANK/scenes/000003.xml; any MJCF file with free bodies;
        or a checkpoint, whose policy then makes the scenes. Without it, --method makes them from --pool.
      pool: a pool's name or folder to sample from where no bank says it; a checkpoint's own if one is given.
      method: random, clear, drop, or a trained policy; the checkpoint's own, else drop.
      num_objects: all of the pool's (40 at most) if not given.
      support: a support's name or folder.
      native: open MuJoCo's own viewer instead (needs a screen).
      host: the address to listen on; 0.0.0.0 lets other machines look.
      port: 0 takes any free one.
      browser: open a browser (--no-browser to leave that to you).
      screenshots: the folder for screenshots.
    """

    source: tyro.conf.Positional[str | None] = None
    pool: str | None = None
    method: Method | None = None
    num_objects: int | None = None
    support: str | None = None
    native: bool = False
    host: str = "localhost"
    port: int = 8080
    browser: bool = True
    screenshots: Path = Path("out/screenshots")

    def run(self) -> int:
        """Runs the command; the exit status. The web viewer runs until Ctrl-C."""
        from cluttergen_jax.generation.sources.viewing import view

        # Whoever reads the address from a pipe waits for it.
        view(**keywords(self), show=partial(print, flush=True))
        return 0
