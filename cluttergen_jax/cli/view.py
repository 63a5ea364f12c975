"""`cluttergen view`: scenes in a browser, or in MuJoCo's own viewer."""

from __future__ import annotations

from functools import partial

from tyro.conf import Positional

from cluttergen_jax.api.view import view
from cluttergen_jax.cli.options import Options, options_from


@options_from(view, source=Positional[str | None])  # type: ignore[misc]
class View(Options):
    """Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.

    Example: `cluttergen view out`, or `cluttergen view --pool dining --method drop`
    """

    def run(self) -> int:
        """Runs the command; the exit status. The web viewer runs until Ctrl-C."""
        # Whoever reads the address from a pipe waits for it.
        self.call(view, show=partial(print, flush=True))
        return 0
