"""`cluttergen`: finds the command that is asked for, and imports no other."""

from __future__ import annotations

import gc
import hashlib
import os
import platform
import signal
import sys
from collections.abc import Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from cluttergen_jax.cli.commands import COMMANDS, all_commands, load, overview
from cluttergen_jax.cli.flags import removed_name, with_flags
from cluttergen_jax.cli.stopping import watch_signals
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest
from cluttergen_jax.files import advice_on, cache_home, check_utf8
from cluttergen_jax.numerics import OF_THIS_PACKAGE
from cluttergen_jax.progress import stop_asked
from cluttergen_jax.rendering.gl import check_importable

INTERRUPTED = 130
_MANY_OBJECTS = 100_000


def program(args: Sequence[str] | None = None) -> None:
    """The console script: `main`, and an exit that waits for nothing once Ctrl-C was pressed."""
    signal.signal(signal.SIGINT, _struck)
    watch_signals(_struck)
    # Imports and traces make millions of objects that stay; looking for garbage among them took a sixth of a
    # short command's time.
    gc.set_threshold(_MANY_OBJECTS)
    # What the API's functions ask of JAX for themselves, in all threads of this process and in its children.
    os.environ.update(OF_THIS_PACKAGE)
    status = main(args)
    if status == INTERRUPTED:
        # What was computed is on disk. A compilation that is still at work in a thread would hold up an
        # orderly exit, or bring it down.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


def _struck(number: int, frame: FrameType | None) -> None:
    """The first Ctrl-C interrupts what is done, in good order; a second one waits for nothing."""
    signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    stop_asked.set()
    raise KeyboardInterrupt


def main(args: Sequence[str] | None = None) -> int:
    """Parses the command line and runs it; the exit status."""
    words = list(sys.argv[1:] if args is None else args)
    if os.environ.get("NO_COLOR"):
        # tyro reads this, and no other, when it is imported.
        os.environ["PYTHON_TYRO_ANSI_CODES"] = "False"
    name = words[0] if words else ""
    if name in ("-h", "--help", "") or name == "--version":
        print(_version() if name == "--version" else overview())
        return 0 if name else 2
    is_completion = name.startswith("--tyro-")
    if not (is_completion or name in COMMANDS):
        given, meant = f"no command is called {name!r}", closest(name, COMMANDS)
        error = ConfigError(given, ", ".join(COMMANDS), "cluttergen --help", meant)
        print(f"error: {error}", file=sys.stderr)
        return 2
    if old := None if is_completion else removed_name(words):
        print(f"error: {old}", file=sys.stderr)
        return 2
    try:
        for path in (os.curdir, str(cache_home()), *words):
            check_utf8(path)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        if is_completion:
            return run(parsed(all_commands(), "cluttergen", words))
        command = parsed(load(name), f"cluttergen {name}", words[1:])
    except BrokenPipeError:
        return _unread()
    except SystemExit as ended:
        # tyro ends the process where it has said what is wrong, or has explained a command.
        return int(ended.code or 0)
    return run(command)


def parsed(command: Any, prog: str, words: Sequence[str]) -> Any:
    """What the words make of a command; tyro exits where they make nothing, or ask for help."""
    import tyro

    config = (tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)
    return tyro.cli(command, prog=prog, args=words, config=config)


def _version() -> str:
    from importlib.metadata import version

    return f"cluttergen_jax {version('cluttergen_jax')}"


def run(command: Any) -> int:
    """Runs a command: its exit status, 2 for an error that was explained, 130 for Ctrl-C."""
    _keep_programs()
    try:
        if getattr(command, "needs_mujoco", True):
            check_importable()
        return command.run()
    except ClutterGenError as error:
        chosen = getattr(command, "action", command)
        kind = type(chosen if is_dataclass(chosen) else command)
        print(f"error: {with_flags(str(error), kind)}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return _unread()
    except OSError as error:
        print(f"error: {_told(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; rerun the command to resume", file=sys.stderr)
        return INTERRUPTED


def _keep_programs() -> None:
    """Lets JAX keep what it compiles for the next command, unless the user has said where, or nowhere.

    A program is made for one kind of processor: machines that share a home have a folder for each kind.
    """
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    kind = {line for line in lines if line.startswith(("model name", "flags", "Features"))}
    digest = hashlib.sha256("\n".join(sorted(kind) or [platform.processor()]).encode()).hexdigest()
    folder = cache_home() / "programs" / f"{platform.machine()}-{digest[:12]}"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(folder))
    # By itself it keeps what took a second; a command has dozens that together take longer.
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def _unread() -> int:
    """Whoever read the output has seen enough; nothing more may be written to it, not even at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _told(error: OSError) -> str:
    """What the operating system refused, and what to try."""
    path = error.filename2 or error.filename
    given = f"{f'{path}: ' if path else ''}{error.strerror or error}"
    return str(ClutterGenError(given, hint=f"{advice_on(error)}, then the same command again"))
