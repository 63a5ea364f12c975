"""Work on strangers' files in a process that has little time and memory: what ends it ends nothing else.

One process serves one program, one call after another. It is begun again after a call that ended it.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, TypeVar

from cluttergen_jax.errors import AssetError, ClutterGenError
from cluttergen_jax.importing.processes import death, limit_memory, most_memory

T = TypeVar("T")
SECONDS = 20
"""Of a processor, for one call."""
_PATIENCE = 4
"""So many times as long may pass, whatever else the machine is busy with."""
_HEAD = 8
_SERVE = "import sys; sys.path[:] = {path!r}; from {module} import serve; serve()"
"""What the process runs: modules come from where this one's do, not from the folder in which it stands."""


def call_limited(
    path: Path, function: Callable[..., T], *arguments: Any, seconds: int = SECONDS
) -> T:
    """What a function of this package returns, or raises, in a process with limits.

    Within a worker process of an import, which has limits itself, it is called there.

    Args:
      path: the file that it works on, for messages.
      seconds: of a processor, that it may take.

    Raises:
      AssetError: the process has ended, or was ended for its time or its memory.
    """
    if multiprocessing.parent_process() is not None or _is_limited:
        return function(*arguments)
    with _lock:
        answer = _server.ask((function, arguments, seconds), seconds)
    if isinstance(answer, str):
        raise AssetError(
            f"{path} cannot be read: {answer}", hint="a file from another source, or a simpler one"
        )
    is_result, value = answer
    if not is_result:
        raise value
    return value


class _Server:
    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, question: Any, seconds: int) -> tuple[bool, Any] | str:
        """Whether there is a result, and it or the error; or how the process has ended."""
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            self._begin()
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Event()

        def end() -> None:
            late.set()
            process.kill()

        watch = threading.Timer(seconds * _PATIENCE, end)
        watch.daemon = True
        try:
            _send(process.stdin, pickle.dumps(question))
            # It has loaded what it needs.
            _receive(process.stdout)
            watch.start()
            return pickle.loads(_receive(process.stdout))
        except (EOFError, OSError):
            code = process.wait()
            self._process = None
            return _reason(code, late.is_set(), seconds)
        except BaseException:
            # What is left of an answer would be taken for the next one.
            self.close()
            raise
        finally:
            watch.cancel()

    def _begin(self) -> None:
        self._owner = os.getpid()
        settings = {
            "OMP_NUM_THREADS": "1",
            "JAX_PLATFORMS": "cpu",
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        }
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SERVE.format(path=sys.path, module=__name__)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | settings,
        )

    def close(self) -> None:
        """Ends the process."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    pipe and pipe.close()


_lock = threading.Lock()
_server = _Server()
_is_limited = False
atexit.register(_server.close)


def _reason(code: int, is_late: bool, seconds: int) -> str:
    if is_late or code == -signal.SIGPROF:
        return f"reading it was not done after {seconds} s"
    if code == _NO_MEMORY:
        return f"reading it takes more than {most_memory() >> 30} GB of memory"
    return death(code).replace("its worker process", "the process that read it")


_NO_MEMORY = 77


def _send(pipe: IO[bytes], data: bytes) -> None:
    pipe.write(len(data).to_bytes(_HEAD, "little") + data)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> bytes:
    head = pipe.read(_HEAD)
    data = pipe.read(int.from_bytes(head, "little")) if len(head) == _HEAD else b""
    if len(head) < _HEAD or len(data) < int.from_bytes(head, "little"):
        raise EOFError
    return data


def serve() -> None:
    """In the process: answers questions until there are no more."""
    global _is_limited
    _is_limited = True
    questions = sys.stdin.buffer
    answers = os.fdopen(os.dup(1), "wb")
    # What libraries print goes nowhere among the answers.
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    while True:
        try:
            function, arguments, seconds = pickle.loads(_receive(questions))
        except EOFError:
            return
        _send(answers, b"")
        _set_alarm(seconds)
        try:
            answer = (True, function(*arguments))
        except MemoryError:
            os._exit(_NO_MEMORY)
        except RecursionError:
            answer = (False, AssetError("what it holds is nested too deeply"))
        except Exception as error:
            answer = (False, error)
        _set_alarm(0)
        _send(answers, _pickle_answer(answer))


def _set_alarm(seconds: float) -> None:
    # Its signal ends the process, in whatever library it is.
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)


def _pickle_answer(answer: tuple[bool, Any]) -> bytes:
    try:
        data = pickle.dumps(answer)
        if not answer[0]:
            # Errors that are made of other arguments than they keep cannot be read again.
            pickle.loads(data)
        return data
    except Exception:
        return pickle.dumps((False, ClutterGenError(str(answer[1]))))
