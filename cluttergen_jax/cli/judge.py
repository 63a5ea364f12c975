"""`cluttergen judge`: anybody's scenes by one strict rule."""

from __future__ import annotations

from tyro.conf import Positional

from cluttergen_jax.cli.options import Options, options_from
from cluttergen_jax.judging.api import judge


@options_from(judge, paths=Positional[tuple[str, ...]], states=str | None)
class Judge(Options):
    """Judge anybody's scenes by one strict rule: MJCF, URDF, SDF or USD files, or arrays of starts.

    Exit status 1 if a file could not be judged; the others are.

    Example: `cluttergen judge kitchen.xml --states starts.npz --hold-joints --out judged`
    """

    def run(self) -> int:
        report = self.call(judge)
        print(report)
        return 1 if report.unread else 0
