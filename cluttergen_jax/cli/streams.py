"""Standard streams that are closed, full or no longer read: the work is done all the same."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any, TextIO

from cluttergen_jax.errors import ClutterGenError

_STDIN, _STDOUT, _STDERR = range(3)


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
