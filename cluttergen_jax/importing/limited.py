"""Work that may crash, never end or take all memory, in processes under limits. Nothing heavy is imported.

A `Crew` has worker processes for many jobs, each in a pool of `pebble`'s, so that the death of one harms no
other. `call_limited` asks one process about a stranger's file; it is no pool, which would run the user's own
script again where that has no `if __name__ == "__main__":`.
"""

from __future__ import annotations

import atexit
import importlib
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from pebble import ProcessExpired, ProcessPool

from cluttergen_jax.errors import AssetError, ClutterGenError
from cluttergen_jax.phases import hear_phases
from cluttergen_jax.progress import stop_asked

T = TypeVar("T")
_LONGEST_WAIT = 1.0
_SHARE = 2 / 3
"""Of the time that a job has left, what a try may take where there is another one."""
_KILLED = -9
_PATIENCE = 4
"""Limits are of a processor's time, so that a busy machine ends nothing; so many times as long may pass."""
_MOST_UNBORN = 3
"""So many workers may end, one after another, before they take a job."""
_BYTES = 8 << 30
_LEAST = 3 << 30
_SETTINGS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"}
"""One thread each, and no GPU. Sums of several threads might end in other bits."""


@dataclass
class Outcome:
    """What became of a job.

    Attributes:
      result: what the function returned; None if there is none.
      fault: why there is none; empty if there is one.
      seconds: what it cost, all tries together, without the start of a process.
      cpu_seconds: likewise, of a processor; of a try that was lost its limit, or the seconds that passed if
        those are fewer.
      is_late: it was ended for its time.
      is_killed: something outside has killed its worker.
    """

    result: Any = None
    fault: str = ""
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    is_late: bool = False
    is_killed: bool = False


Again = Callable[[Any, str], Any]
"""From a job and the fault by which it was lost to the job that is tried in its stead."""
Watch = Callable[[dict[int, str]], None]
"""Hears which jobs are at work, by index, and what each is at (`phases.say_phase`); "" for nothing said."""
_MOST_TOLD = 240
"""Bytes of what a worker is at."""


def run_all(
    function: Callable[[Any], str], jobs: Sequence[Any], num_processes: int
) -> Iterator[tuple[int, str]]:
    """Yields (index, result) of `function(job)` as they come; of a job that was lost, why.

    Left early, as by Ctrl-C, it ends its workers.
    """
    with closing(Crew(function, num_processes)) as crew:
        for index, outcome in crew.outcomes(jobs):
            yield index, outcome.fault or outcome.result


@dataclass
class _Task:
    """One job, its tries so far, and what became of the last."""

    index: int
    job: Any
    tries: int = 0
    spent: float = 0.0  # Seconds of its limit.
    limit: float | None = None  # Of the try at work.
    began: float = 0.0  # On the monotonic clock; 0 if it waits for its worker to start.
    outcome: Outcome = field(default_factory=Outcome)


class Crew:
    """Worker processes, one job each at a time.

    A worker that dies takes one job with it. If something outside has killed it, for want of memory
    perhaps, the job is tried a second time when all others are done, alone. After any other death, and
    after a job over its time, which is ended with its worker, the next try is what `again` makes of the
    job, if that is given.

    Args:
      function: of a job, for all workers; it and the jobs are pickled.
      num_processes: at a time; where jobs are fewer, each has threads of its own for CoACD.
      limit: seconds of a processor that a job may take, all tries together; None for as long as it likes.
      again: makes the next job.
      most_tries: of a job, where `again` is given.
      watch: hears, every second or oftener, which jobs are at work, by index, and what each is at.
      is_limited: each may take so much memory as `most_memory` says.
    """

    def __init__(
        self,
        function: Callable[[Any], Any],
        num_processes: int,
        limit: float | None = None,
        again: Again | None = None,
        most_tries: int = 2,
        watch: Watch | None = None,
        is_limited: bool = False,
    ) -> None:
        self._function = function
        self._num = num_processes
        self._limit = limit
        self._again = again
        self._most_tries = most_tries if again is not None else 1
        self._watch = watch
        self._start = (function.__module__, is_limited)
        self._num_threads = 1
        self._phases: dict[ProcessPool, Any] = {}
        self._idle: list[ProcessPool] = []
        self._busy: dict[Future[_Done], tuple[ProcessPool, _Task]] = {}
        self._waiting: deque[_Task] = deque()
        self._last: deque[_Task] = deque()
        self._num_unborn = 0

    def outcomes(self, jobs: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """Yields (index, outcome) of each job as they come.

        Raises:
          ClutterGenError: workers end before they take a job.
          Exception: what the function raised.
        """
        # CoACD, which is most of the work, finds the same with any number of threads.
        self._num_threads = max(1, self._num // max(1, len(jobs)))
        self._waiting = deque(_Task(index, job) for index, job in enumerate(jobs))
        self._last.clear()
        while self._waiting or self._last or self._busy:
            if stop_asked.is_set():
                raise KeyboardInterrupt
            self._hand_out()
            if self._watch is not None:
                self._watch({task.index: self._phase(pool) for pool, task in self._busy.values()})
            done, _ = wait(self._busy, _LONGEST_WAIT, FIRST_COMPLETED)
            for future, (_, task) in self._busy.items():
                task.began = task.began or (time.monotonic() if future.running() else 0.0)
            for future in done:
                task = self._busy[future][1]
                if self._is_over(future):
                    yield task.index, task.outcome

    def _phase(self, pool: ProcessPool) -> str:
        return bytes(self._phases[pool].value).decode(errors="ignore")

    def close(self) -> None:
        """Ends the workers, whatever they do."""
        pools = [*self._idle, *(pool for pool, _ in self._busy.values())]
        self._idle.clear()
        self._busy.clear()
        self._phases.clear()
        for pool in pools:
            pool.stop()
        for pool in pools:
            pool.join()

    def _hand_out(self) -> None:
        while self._waiting and len(self._busy) < self._num:
            self._give(self._waiting.popleft())
        if self._last and not self._waiting and not self._busy:
            # Idle workers hold memory, of which there may have been too little.
            self.close()
            self._give(self._last.popleft())

    def _give(self, task: _Task) -> None:
        if not self._idle:
            context = multiprocessing.get_context("spawn")
            # Without a lock, which a worker that is killed would keep.
            phase = context.RawArray("c", _MOST_TOLD + 1)
            start = (*self._start, self._num_threads, phase)
            pool = ProcessPool(1, initializer=_begin, initargs=start, context=context)
            self._phases[pool] = phase
            self._idle.append(pool)
        pool = self._idle.pop()
        self._phases[pool].value = b""
        task.began = 0.0
        task.limit = None
        if self._limit is not None:
            left = self._limit - task.spent
            task.limit = left * _SHARE if task.tries < self._most_tries - 1 else max(left, 1.0)
        longest = None if task.limit is None else task.limit * _PATIENCE
        future = pool.schedule(_run, (self._function, task.job, task.limit), timeout=longest)
        self._busy[future] = (pool, task)

    def _is_over(self, future: Future[_Done]) -> bool:
        """Whether a task that was done or lost is over for good; else it waits for its next try."""
        pool, task = self._busy.pop(future)
        try:
            done = future.result()
        except (ProcessExpired, TimeoutError) as error:
            self._num_unborn = 0
            self._idle.append(pool)
            return self._is_given_up(task, getattr(error, "exitcode", None))
        except BrokenProcessPool as error:
            pool.join()
            self._num_unborn += 1
            if self._num_unborn >= _MOST_UNBORN:
                raise ClutterGenError(
                    "worker processes end before they begin",
                    hint='in a script of your own, calling it below `if __name__ == "__main__":`',
                ) from error
            self._waiting.appendleft(task)
            return False
        self._num_unborn = 0
        self._idle.append(pool)
        task.outcome.seconds += done.seconds
        task.outcome.cpu_seconds += done.cpu_seconds
        if done.error is not None:
            raise done.error
        task.outcome.result = done.result
        task.outcome.fault = ""
        return True

    def _is_given_up(self, task: _Task, exit_code: int | None) -> bool:
        """Whether a task whose worker has died, by itself or for its time (None), is not tried again."""
        outcome = task.outcome
        seconds = time.monotonic() - task.began if task.began else 0.0
        outcome.is_late = exit_code is None or exit_code == -_OVERTIME
        outcome.is_killed = exit_code == _KILLED
        used = seconds
        if task.limit is not None:
            used = task.limit if outcome.is_late else min(seconds, task.limit)
        task.tries += 1
        task.spent += used
        outcome.seconds += seconds
        outcome.cpu_seconds += used
        outcome.fault = death(exit_code)
        if outcome.is_late:
            outcome.fault = f"it was not done after {task.spent:.{0 if task.spent >= 10 else 1}f} s"
        if task.tries >= (2 if outcome.is_killed else self._most_tries):
            return True
        if outcome.is_killed:
            # What it took in the company of others that had the memory does not count.
            task.spent = 0.0
            self._last.append(task)
        elif self._again is not None:
            task.job = self._again(task.job, outcome.fault)
            self._waiting.appendleft(task)
        return False


def death(exit_code: int | None) -> str:
    """What an exit status says of the end of a process."""
    if exit_code is None or exit_code >= 0:
        return f"its worker process ended with status {exit_code}"
    try:
        name = signal.Signals(-exit_code).name
        meaning = signal.strsignal(-exit_code) or ""
    except ValueError:
        name = f"signal {-exit_code}"
        meaning = ""
    if name == "SIGKILL":
        return "its worker process was killed from outside (SIGKILL), perhaps for want of memory"
    if name in ("SIGTERM", "SIGINT", "SIGHUP"):
        return f"its worker process was ended from outside ({name})"
    return f"its worker process crashed ({name}{f': {meaning.lower()}' if meaning else ''})"


@dataclass(frozen=True)
class _Done:
    """Said by a worker when a job is over."""

    result: Any
    error: Exception | None
    seconds: float
    cpu_seconds: float


def _begin(module: str, is_limited: bool, num_threads: int, phase: Any) -> None:
    """In a worker, before its first job: settings, and then what the function and its jobs need.

    Args:
      phase: shared with the parent, to which it says what it is at.
    """
    # pebble's own answer to it waits for the end of whatever library is at work.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.environ.update(_SETTINGS | {"OMP_NUM_THREADS": str(num_threads)})
    if is_limited:
        limit_memory()
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def hear(text: str) -> None:
        phase.value = text.encode()[:_MOST_TOLD]

    hear_phases(hear)
    importlib.import_module(module)


def _run(function: Callable[[Any], Any], job: Any, limit: float | None) -> _Done:
    start = time.perf_counter()
    cpu_start = time.process_time()
    result = None
    failure = None
    limit_time(limit or 0)
    try:
        result = function(job)
    except Exception as error:
        failure = error
    limit_time(0)
    return _Done(result, failure, time.perf_counter() - start, time.process_time() - cpu_start)


def _end_with_parent() -> None:
    """A parent that was killed ends nobody, and a worker at work does not hear that it is gone."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def most_memory() -> int:
    """Bytes that a process may take that reads a stranger's file: 8 GB, or half of a smaller machine."""
    try:
        whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError, AttributeError):
        return _BYTES
    return max(min(_BYTES, whole // 2), _LEAST)


def limit_memory() -> None:
    """Gives this process `most_memory`, where the system knows limits."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        most = most_memory() if hard == resource.RLIM_INFINITY else min(most_memory(), hard)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))


_OVERTIME = getattr(signal, "SIGPROF", 27)


def limit_time(seconds: float) -> None:
    """Ends this process, in whatever library it is, after seconds of a processor; 0 takes the limit away."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)


SECONDS = 20
"""Of a processor, for one call."""
_SERVE = "import sys; sys.path[:] = {path!r}; from {module} import serve; serve({pipe})"
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
        is_late = False
        try:
            self._pipe.send(question)
            # It has loaded what it needs.
            self._pipe.recv()
            if self._pipe.poll(seconds * _PATIENCE):
                answer: tuple[bool, Any] = self._pipe.recv()
                return answer
            is_late = True
            process.kill()
        except (EOFError, OSError):
            pass
        except BaseException:
            # What is left of an answer would be taken for the next one.
            self.close()
            raise
        code = process.wait()
        self.close()
        return _reason(code, is_late, seconds)

    def _begin(self) -> None:
        self._owner = os.getpid()
        self._pipe, theirs = multiprocessing.Pipe()
        pipe = theirs.fileno()
        settings = {**_SETTINGS, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SERVE.format(path=sys.path, module=__name__, pipe=pipe)],
            stdin=subprocess.DEVNULL,
            # What libraries print is no output of this program.
            stdout=2,
            env=os.environ | settings,
            pass_fds=[pipe],
        )
        theirs.close()

    def close(self) -> None:
        """Ends the process."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            process.wait()
            self._pipe.close()


_lock = threading.Lock()
_server = _Server()
_is_limited = False
atexit.register(_server.close)


def _reason(code: int, is_late: bool, seconds: int) -> str:
    if is_late or code == -_OVERTIME:
        return f"reading it was not done after {seconds} s"
    if code == _NO_MEMORY:
        return f"reading it takes more than {most_memory() >> 30} GB of memory"
    return death(code).replace("its worker process", "the process that read it")


_NO_MEMORY = 77


def serve(number: int) -> None:
    """In the process: answers questions from the pipe of a number until there are no more."""
    global _is_limited
    _is_limited = True
    pipe = Connection(number)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    while True:
        try:
            function, arguments, seconds = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(None)
        limit_time(seconds)
        try:
            answer = (True, function(*arguments))
        except MemoryError:
            os._exit(_NO_MEMORY)
        except RecursionError:
            answer = (False, AssetError("what it holds is nested too deeply"))
        except Exception as error:
            answer = (False, error)
        limit_time(0)
        pipe.send_bytes(_pickle_answer(answer))


def _pickle_answer(answer: tuple[bool, Any]) -> bytes:
    try:
        data = pickle.dumps(answer)
        if not answer[0]:
            # Errors that are made of other arguments than they keep cannot be read again.
            pickle.loads(data)
        return data
    except Exception:
        return pickle.dumps((False, ClutterGenError(str(answer[1]))))
