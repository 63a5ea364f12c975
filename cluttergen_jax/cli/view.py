"""`cluttergen view`: scenes in a browser, to be looked at or made by hand, or in MuJoCo's own viewer."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from tyro.conf import Positional, arg

from cluttergen_jax.api.place import place_by_hand
from cluttergen_jax.api.view import view
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, options_from


@options_from(
    view,
    place_by_hand,
    source=Positional[str | None],  # type: ignore[misc]
    region=str | None,
    keep_out=tuple[str, ...],
    place=Annotated[
        bool,
        arg(
            help="place objects by hand (by default of dining, on the paper's table), and keep the scenes."
        ),
    ],
)
class View(Options):
    """Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.

    Example: `cluttergen view out`, or `cluttergen view --pool dining --method drop`; to make scenes by hand,
    `cluttergen view --place --pool dining --num-objects 5 --out mine`
    """

    def run(self) -> int:
        """Runs the command; the exit status. The web viewer runs until Ctrl-C."""
        # Whoever reads the address from a pipe waits for it.
        show = partial(print, flush=True)
        if self.place:
            hint = "leaving it out: scenes made by hand have their own bank"
            bank = self.call(place_by_hand, "with --place", hint, ("place",), show=show)
            print(with_flags(str(bank), type(self)))
        else:
            self.call(view, "without --place", "--place, to make scenes by hand", show=show)
        return 0
