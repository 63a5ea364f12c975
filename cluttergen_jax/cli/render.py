"""`cluttergen render`: pictures, films, contact sheets and measurements of scenes."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from tyro.conf import Positional

from cluttergen_jax.api.render import render
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.errors import ClutterGenError


@options_from(render, source=Positional[str])
class Render(Options):
    """Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure.

    Example: `cluttergen render out --sheet --turntable`
    """

    def run(self) -> int:
        """Runs the command; the exit status, 1 if something could not be made."""
        report = self.call(render)
        for path in report.paths:
            print(path)
        for note in report.notes:
            print(f"note: {with_flags(note, type(self))}", file=sys.stderr)
        if report.failures:
            print(with_flags(failures_text(report.failures), type(self)), file=sys.stderr)
        return 1 if report.failures else 0


def failures_text(failures: Sequence[tuple[str, ClutterGenError]]) -> str:
    """What could not be made and why, a line each; what to try, once."""
    lines = [f"error: {len(failures)} could not be made, the rest was:"]
    lines += [f"  {name}: {error.given}" for name, error in failures]
    hints = dict.fromkeys(error.hint for _, error in failures if error.hint)
    return "\n".join([*lines, *(f"Try: {hint}." for hint in hints)])
