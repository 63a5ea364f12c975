"""`cluttergen generate`: a bank of scenes, with progress, a summary, and files to look at."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import arg

from cluttergen_jax.api.generate import generate
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import Options, options_from


@options_from(
    generate,
    num_scenes=Annotated[int, arg(aliases=["-n"])],
    region=str | None,
    keep_out=tuple[str, ...],
    clutter=str | None,
)
class Generate(Options):
    """Generate verified cluttered scenes and save them as a bank.

    Example: `cluttergen generate --pool dining --num-scenes 100 --out bank`
    """

    def run(self) -> int:
        print(
            with_flags(str(self.call(generate, only_changed=self.layout is not None)), type(self))
        )
        return 0
