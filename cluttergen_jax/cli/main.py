"""The console script `cluttergen`."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import tyro

from cluttergen_jax.cli.doctor import Doctor
from cluttergen_jax.cli.generate import Generate
from cluttergen_jax.cli.list_ import List
from cluttergen_jax.cli.verify import Verify
from cluttergen_jax.errors import ClutterGenError

Command = (
    Annotated[Generate, tyro.conf.subcommand("generate")]
    | Annotated[Verify, tyro.conf.subcommand("verify")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
)


def run(command: Any) -> int:
    """Runs a command: its exit status, 2 for an error that was explained, 130 for Ctrl-C."""
    try:
        return command.run()
    except ClutterGenError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; the same command takes it up again", file=sys.stderr)
        return 130


def main(args: list[str] | None = None) -> int:
    """Parses the command line and runs it."""
    config = (tyro.conf.FlagConversionOff, tyro.conf.OmitSubcommandPrefixes)
    return run(tyro.cli(Command, prog="cluttergen", description=__doc__, args=args, config=config[1:]))
