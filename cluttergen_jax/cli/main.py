"""`cluttergen`: the commands by name; finds the one that is asked for, and imports no other."""

from __future__ import annotations

import contextlib
import errno
import functools
import gc
import io
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from importlib import import_module
from operator import or_
from types import FrameType
from typing import Annotated, Any, TextIO

from cluttergen_jax.cli.flags import error_with_flags, options_known, with_new_names
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest, printable
from cluttergen_jax.files import advice_on, cache_home, check_utf8
from cluttergen_jax.numerics import OF_THIS_PACKAGE, program_folder
from cluttergen_jax.progress import stop_asked
from cluttergen_jax.rendering.gl import check_importable

INTERRUPTED = 130
_MANY_OBJECTS = 100_000
_MOST_COLUMNS = 129
"""Of a help text: tyro makes a second column of 130 and more."""
_MOMENT = 0.05
"""Seconds after which a Ctrl-C that came during an import is tried again."""
_STDIN, _STDOUT, _STDERR = range(3)


def program(
    args: Sequence[str] | None = None, run_args: Callable[[Any], int] | None = None
) -> None:
    """The console script: `main`, and an exit that waits for nothing once Ctrl-C was pressed.

    Args:
      run_args: a program of its own in the place of `main`.
    """
    streams = Streams()
    signal.signal(signal.SIGINT, _on_interrupt)
    watch_signals(_on_interrupt)
    # Imports and traces make millions of objects that stay; looking for garbage among them took a sixth of a
    # short command's time.
    gc.set_threshold(_MANY_OBJECTS)
    # What the API's functions ask of JAX for themselves, in all threads of this process and in its children.
    os.environ.update(OF_THIS_PACKAGE)
    if os.environ.get("NO_COLOR"):
        # tyro reads this, and no other, when it is imported.
        os.environ["PYTHON_TYRO_ANSI_CODES"] = "False"
    try:
        status = (run_args or main)(args)
    except KeyboardInterrupt:
        print("\nstopped; nothing was done yet", file=sys.stderr)
        status = INTERRUPTED
    if (error := streams.flush()) is not None:
        print(f"error: {output_error_text(error)}", file=sys.stderr, flush=True)
        status = status or 2
    if status == INTERRUPTED:
        # What was computed is on disk. A compilation that is still at work in a thread would hold up an
        # orderly exit, or bring it down.
        os._exit(status)
    sys.exit(status)


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    """The first Ctrl-C interrupts what is done, in good order; a second one waits for nothing."""
    if _is_importing(frame):
        # A compiled library that is interrupted while it is loaded brings the process down: a moment later.
        signal.signal(signal.SIGALRM, _on_interrupt)
        signal.setitimer(signal.ITIMER_REAL, _MOMENT)
        return
    signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    stop_asked.set()
    raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    """Whether an import is under way in a frame or those that called it."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def main(args: Sequence[str] | None = None) -> int:
    """Parses the command line and runs it; the exit status."""
    words = list(sys.argv[1:] if args is None else args)
    name = words[0] if words else ""
    if words[:2] == ["layout", "--schema"]:
        words[1] = "schema"
    if name in ("-h", "--help", "") or name == "--version":
        print(_version() if name == "--version" else overview())
        return 0 if name else 2
    is_completion = name.startswith("--tyro-")
    if not (is_completion or name in COMMANDS):
        given = f"no command is called {name!r}"
        meant = closest(name, COMMANDS)
        error = ConfigError(given, ", ".join(COMMANDS), "cluttergen --help", meant)
        print(f"error: {error}", file=sys.stderr)
        return 2
    if is_completion:
        return run_words(all_commands, "cluttergen", words)
    if name == "evaluate" and any(word.partition("=")[0] == "--suite" for word in words):
        print(f"error: {ConfigError(*_NO_SUITE)}", file=sys.stderr)
        return 2
    return run_words(lambda: load(name), f"cluttergen {name}", words[1:])


_NO_SUITE = (
    "`cluttergen evaluate` with --suite: suites are not part of the installed package",
    "a checkout of the repository, where they are in the folder `studies`",
    "`python evaluate.py --suite ...` in a checkout's folder",
)


def run_words(command: Callable[[], Any], prog: str, words: Sequence[str]) -> int:
    """Parses words as options of a command and runs it; the exit status.

    Args:
      command: imports the command's class.
      prog: how the command is called, for its help.
    """
    try:
        for path in (os.curdir, str(cache_home()), *words):
            check_utf8(path)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        made = command()
        words, notes = with_new_names(words, options_known(made))
        for note in notes:
            print(f"note: {note}", file=sys.stderr)
        parsed = parse_words(made, prog, words)
    except SystemExit as ended:
        # tyro ends the process where it has said what is wrong, or has explained a command.
        return int(ended.code or 0)
    return run(parsed)


def parse_words(command: Any, prog: str, words: Sequence[str]) -> Any:
    """What the words make of a command; tyro exits where they make nothing, or ask for help."""
    import tyro

    config = (tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)
    with _narrow_terminal():
        return tyro.cli(getattr(command, "parser", command), prog=prog, args=words, config=config)


@contextlib.contextmanager
def _narrow_terminal() -> Iterator[None]:
    """Groups of options stand below each other: in wider terminals tyro puts them side by side, mixed."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(min(shutil.get_terminal_size().columns, _MOST_COLUMNS))
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before


def _version() -> str:
    from importlib.metadata import version

    return f"cluttergen_jax {version('cluttergen_jax')}"


def run(command: Any) -> int:
    """Runs a command: its exit status, 2 for an error that was explained, 130 for Ctrl-C."""
    _keep_programs()
    try:
        if command.needs_mujoco:
            check_importable()
        return command.run()
    except ClutterGenError as error:
        chosen = getattr(command, "action", command)
        text = error_with_flags(error, chosen if is_dataclass(chosen) else command)
        print(f"error: {printable(text)}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {printable(_os_error_text(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        # One that was raised where everything is saved may say what is left.
        print(f"\nstopped; {str(stop) or command.told_when_stopped}", file=sys.stderr)
        return INTERRUPTED


def _keep_programs() -> None:
    """Lets JAX keep what it compiles for the next command, unless the user has said where, or nowhere."""
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(program_folder()))
    # By itself it keeps what took a second; a command has dozens that together take longer.
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def _os_error_text(error: OSError) -> str:
    """What the operating system refused, and what to try."""
    path = error.filename2 or error.filename
    given = f"{f'{path}: ' if path else ''}{error.strerror or error}"
    return str(ClutterGenError(given, hint=f"{advice_on(error)}, then the same command again"))


GRACE = 3.0
"""Seconds in which a signal has to be answered."""


def watch_signals(usual: Callable[..., Any]) -> None:
    """Ends the process with 128 + the signal where one is not answered in time. For the main thread, once.

    Python answers a signal between two steps of the main thread. One that comes while that thread is in
    compiled code is seen by a thread of its own. What is on disk is whole whenever a process ends.

    Args:
      usual: the handler of Ctrl-C that is there as long as nobody has answered, or has taken it over to save
        what there is first (`learning.training.run_folder`). A second signal waits for nobody.
    """
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    signal.set_wakeup_fd(writes, warn_on_full_buffer=False)

    def watch() -> None:
        count = 0
        while True:
            for number in os.read(reads, 64):
                if number in (signal.SIGINT, signal.SIGTERM):
                    count += 1
                    threading.Thread(
                        target=_end_late, args=(number, count, usual), daemon=True
                    ).start()

    threading.Thread(target=watch, daemon=True).start()


def _end_late(number: int, count: int, usual: Callable[..., Any]) -> None:
    time.sleep(GRACE)
    if count > 1 or signal.getsignal(signal.SIGINT) is usual:
        print("\nstopped; rerun the command to resume", file=sys.stderr, flush=True)
        os._exit(128 + number)


# Standard streams that are closed, full or no longer read: the work is done all the same.


class _Output(io.FileIO):
    """Bytes that are written as long as they can be; the first error is kept, and raised by no call."""

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        if self.error is None:
            try:
                return super().write(data)
            except OSError as error:
                self.error = error
        return memoryview(data).nbytes


class Streams:
    """Takes over stdout and stderr of this process, and opens those of the three that are closed.

    A closed one is the null device from now on: the next file that is opened would otherwise get its number,
    and what compiled libraries log would be written into it. For the main thread of a program, once.
    """

    def __init__(self) -> None:
        _open_closed()
        self._stdout = _Output(_STDOUT, "w", closefd=False)
        sys.stdin = sys.stdin or open(_STDIN, encoding="utf-8", closefd=False)  # noqa: SIM115, for the process
        sys.stdout = _text(self._stdout, sys.stdout, "strict")
        sys.stderr = _text(_Output(_STDERR, "w", closefd=False), sys.stderr, "backslashreplace")

    def flush(self) -> OSError | None:
        """Writes what is left; the error of stdout, if there was one that is worth a word.

        None where its reader has seen enough, `head` for instance.
        """
        sys.stdout.flush()
        sys.stderr.flush()
        error = self._stdout.error
        return None if error is None or error.errno == errno.EPIPE else error


def _open_closed() -> None:
    for number in (_STDIN, _STDOUT, _STDERR):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number is the one that is closed.
            opened = os.open(os.devnull, os.O_RDONLY if number == _STDIN else os.O_WRONLY)
            os.set_inheritable(opened, True)


def _text(raw: _Output, usual: TextIO | None, errors: str) -> io.TextIOWrapper:
    """The stream as text, encoded and buffered as the one that Python made, if it made one."""
    if isinstance(usual, io.TextIOWrapper):
        usual.flush()
        return io.TextIOWrapper(
            io.BufferedWriter(raw),
            usual.encoding,
            usual.errors,
            line_buffering=usual.line_buffering,
            write_through=usual.write_through,
        )
    return io.TextIOWrapper(io.BufferedWriter(raw), "utf-8", errors)


def output_error_text(error: OSError) -> str:
    """What is said where the output could not be written."""
    given = f"the output (stdout) cannot be written: {error.strerror or error}. What the command made is kept"
    hint = "another place for the output: a terminal, a pipe, or a file on a disk with room"
    return str(ClutterGenError(given, hint=hint))


COMMANDS = {
    "generate": "Generate verified cluttered scenes and save them as a bank.",
    "verify": "Check that saved scenes are stable, in plain MuJoCo. Exit status 1 if one is not.",
    "judge": "Judge anybody's scenes by one strict rule: MJCF, URDF, SDF or USD files, or arrays of starts.",
    "layout": "Layouts, what shall stand where: `layout ask`, `layout check`, and `layout --schema`.",
    "repair": "Make broken layouts stable with little motion: noisy poses, JSON of a language model.",
    "export": "Write scenes of a bank as a self-contained folder for another program.",
    "cut": "Make a bank of some scenes of another, numbered anew from 0. Rerun to resume.",
    "certify": "Add a stability certificate to each successful scene of a bank, a column for each measure.",
    "stats": "Show what a bank holds: successes, failures by reason, objects, attempts, duplicates, gaps.",
    "push": "Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.",
    "pull": "Fetch a bank, or policies, from the Hugging Face Hub (extra `hub`) and check every file of it.",
    "view": "Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.",
    "render": (
        "Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure."
    ),
    "dataset": "Make a dataset of views of banks: colour, depth, labels, masks, poses. Rerun to resume.",
    "train": "Train a placement policy with PPO. Rerun to resume.",
    "pretrain": "Pretrain a point encoder by classifying shapes. Rerun to resume.",
    "evaluate": "Compare methods on pools and supports.",
    "placer": "Stable placement from one camera's view: `placer data`, `placer train` and `placer eval`.",
    "robot": (
        "A robot arm in simulation: grasps, episodes, recordings, grasp data, rounds in clutter, checks."
    ),
    "rearrange": "Let a simulated robot arm rearrange the objects of scenes (extra `robot`).",
    "import": (
        "Import objects as a pool, or a table: OBJ, STL, PLY, GLB, GLTF, DAE, URDF, SDF, MJCF, or `ycb`."
    ),
    "pool": (
        "List pools, show what one holds, remove your own, or change an object's pose: cluttergen pool list."
    ),
    "inspect": "Show what was measured about objects of a pool, or surfaces of a support; draw it.",
    "list": "List pools and their objects, supports, layouts, robots and checkpoints.",
    "doctor": "Show versions, devices, renderers and extras.",
}
"""What each command is for: the first line of its docstring."""
_MODULES = {
    "doctor": ("doctor",),
    "downstream": ("placer", "robot", "rearrange"),
    "layouts": ("layout",),
    "learning": ("train", "pretrain", "evaluate"),
    "pools": ("import", "pool", "inspect", "list"),
}
"""Where commands are defined; the others are in `scenes`."""
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def load(name: str) -> Any:
    """The class of a command's options; importing it imports no JAX and no MuJoCo."""
    module = import_module(f"cluttergen_jax.cli.{_MODULE_OF.get(name, 'scenes')}")
    return getattr(module, f"run_{name}").options


def all_commands() -> Any:
    """The union of all commands as tyro takes it: what a shell's completion is made of."""
    from tyro.conf import subcommand

    kinds = {name: load(name) for name in COMMANDS}
    return functools.reduce(
        or_,
        (
            Annotated[kind, subcommand(name, constructor=kind.parser)]
            for name, kind in kinds.items()
        ),
    )


def overview() -> str:
    """What `cluttergen --help` says."""
    lines = [f"  {name:<12}{about}" for name, about in COMMANDS.items()]
    return "\n".join(
        [
            "usage: cluttergen COMMAND [OPTIONS]",
            "",
            "Cluttered, physically stable, diverse tabletop scenes.",
            "",
            "commands:",
            *lines,
            "",
            "options:",
            "  -h, --help                          this text; after a command, its options",
            "  --version                           the version",
            "  --tyro-write-completion SHELL FILE  completion for bash, zsh, fish or tcsh (docs/start.md)",
            "",
            "Example: cluttergen generate --pool dining --num-scenes 20 --out bank",
        ]
    )
