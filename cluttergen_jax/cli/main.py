"""Cluttered, physically stable, diverse tabletop scenes."""

from __future__ import annotations

import errno
import os
import sys
from typing import Annotated, Any

import tyro

from cluttergen_jax.errors import ClutterGenError

_ADVICE = {
    errno.EEXIST: "another --out: where a folder has to be, there is a file",
    errno.ENOTDIR: "another --out: where a folder has to be, there is a file",
    errno.EISDIR: "another --out: where a file has to be, there is a folder",
    errno.ENOENT: "a path that exists",
    errno.EACCES: "a folder that you may write to",
    errno.EPERM: "a folder that you may write to",
    errno.EROFS: "a folder on a disk that can be written",
    errno.ENOSPC: "making room on the disk, then the same command again",
}


def commands() -> Any:
    """The union of all commands. They are imported here so that an import that fails can be explained."""
    from cluttergen_jax.cli.certify import Certify
    from cluttergen_jax.cli.doctor import Doctor
    from cluttergen_jax.cli.evaluate import Evaluate
    from cluttergen_jax.cli.export import Export
    from cluttergen_jax.cli.generate import Generate
    from cluttergen_jax.cli.import_ import Import
    from cluttergen_jax.cli.inspect_ import Inspect
    from cluttergen_jax.cli.list_ import List
    from cluttergen_jax.cli.pretrain import Pretrain
    from cluttergen_jax.cli.pull import Pull
    from cluttergen_jax.cli.push import Push
    from cluttergen_jax.cli.render import Render
    from cluttergen_jax.cli.stats import Stats
    from cluttergen_jax.cli.train import Train
    from cluttergen_jax.cli.verify import Verify
    from cluttergen_jax.cli.view import View

    return (
        Annotated[Generate, tyro.conf.subcommand("generate")]
        | Annotated[Verify, tyro.conf.subcommand("verify")]
        | Annotated[Export, tyro.conf.subcommand("export")]
        | Annotated[Certify, tyro.conf.subcommand("certify")]
        | Annotated[Stats, tyro.conf.subcommand("stats")]
        | Annotated[Push, tyro.conf.subcommand("push")]
        | Annotated[Pull, tyro.conf.subcommand("pull")]
        | Annotated[View, tyro.conf.subcommand("view")]
        | Annotated[Render, tyro.conf.subcommand("render")]
        | Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Pretrain, tyro.conf.subcommand("pretrain")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Import, tyro.conf.subcommand("import")]
        | Annotated[Inspect, tyro.conf.subcommand("inspect")]
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
    except BrokenPipeError:
        # Whoever read the output has seen enough; nothing more may be written to it, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        print(f"error: {_told(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; the same command takes it up again", file=sys.stderr)
        return 130


def _told(error: OSError) -> str:
    """What the operating system refused, and what to try."""
    path = error.filename2 or error.filename
    advice = _ADVICE.get(error.errno or 0, "mending that, then the same command again")
    return str(ClutterGenError(f"{f'{path}: ' if path else ''}{error.strerror or error}", hint=advice))


def main(args: list[str] | None = None) -> int:
    """Parses the command line and runs it."""
    try:
        command = commands()
    except (RuntimeError, ImportError, AttributeError) as error:
        if os.environ.get("MUJOCO_GL"):
            # MuJoCo itself refuses to be imported when MUJOCO_GL names a backend that it cannot load.
            print(
                f"error: MUJOCO_GL={os.environ['MUJOCO_GL']}: {error} Try: unset MUJOCO_GL.", file=sys.stderr
            )
            return 2
        raise
    return run(
        tyro.cli(
            command,
            prog="cluttergen",
            description=__doc__,
            args=args,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        )
    )
