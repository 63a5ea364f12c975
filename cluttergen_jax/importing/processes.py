"""Spawned worker processes that survive a crash, a job without an end and a Ctrl-C. Imports nothing heavy."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.progress import stop_asked

_LONGEST_WAIT = 1.0
_SHARE = 2 / 3
"""Of the time that a job has left, what a try may take where there is another one."""
_KILLED = -9
_PATIENCE = 4.0
"""Of a job's time the processor's counts, whatever else the machine is busy with; but so many seconds that
pass count as one at least, for a job that waits for ever."""
_MOST_UNBORN = 3
"""So many workers may end, one after another, before they take a job."""


_BYTES = 8 << 30
_LEAST = 3 << 30


@dataclass
class Outcome:
    """What became of a job."""

    result: Any = None  # What the function returned; None if there is none.
    fault: str = ""  # Why there is none; empty if there is one.
    seconds: float = 0.0  # What it cost, all tries together, without the start of a process.
    cpu_seconds: float = 0.0
    is_late: bool = False  # Whether it was ended for its time.
    is_killed: bool = False  # Whether something outside has killed its worker.


Again = Callable[[Any, str], Any]
"""From a job and the fault by which it was lost to the job that is tried in its stead."""
Watch = Callable[[list[int]], None]
"""Hears which jobs are at work, by index."""


def run_all(
    function: Callable[[Any], str], jobs: Sequence[Any], num_processes: int
) -> Iterator[tuple[int, str]]:
    """Yields (index, result) of `function(job)` as they come; of a job that was lost, why.

    Left early, as by Ctrl-C, it ends its workers.
    """
    with closing(Crew(function, num_processes)) as crew:
        for index, outcome in crew.outcomes(jobs):
            yield index, outcome.fault or outcome.result


class Crew:
    """Worker processes, one job each at a time.

    A worker that dies takes one job with it. If something outside has killed it, for want of memory
    perhaps, the job is tried a second time when all others are done, alone. After any other death, and
    after a job over its time, which is ended with its worker, the next try is what `again` makes of the
    job, if that is given.

    Args:
      function: of a job, for all workers; it and the jobs are pickled.
      num_processes: at a time.
      limit: seconds that a job may take, all tries together, of the processor where the system reports them;
        None for as long as it likes.
      again: makes the next job.
      most_tries: of a job, where `again` is given.
      watch: hears, every second or oftener, which jobs are at work, by index.
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
        self._is_limited = is_limited
        self._workers: list[_Worker] = []
        self._waiting: deque[_Task] = deque()
        self._last: deque[_Task] = deque()
        self._num_unborn = 0

    def outcomes(self, jobs: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """Yields (index, outcome) of each job as they come.

        Raises:
          ClutterGenError: workers end before they take a job.
          Exception: what the function raised.
        """
        self._waiting = deque(_Task(index, job) for index, job in enumerate(jobs))
        self._last.clear()
        num_left = len(jobs)
        while num_left:
            if stop_asked.is_set():
                raise KeyboardInterrupt
            self._hand_out()
            if self._watch is not None:
                self._watch(
                    [worker.task.index for worker in self._workers if worker.task is not None]
                )
            for worker in self._workers_to_hear():
                if (task := self._over(worker)) is not None:
                    num_left -= 1
                    yield task.index, task.outcome

    def close(self) -> None:
        """Ends the workers, whatever they do."""
        for worker in self._workers:
            worker.kill()
        self._workers = []

    def _hand_out(self) -> None:
        busy = [worker for worker in self._workers if worker.task is not None]
        free = [worker for worker in self._workers if worker.task is None]
        while self._waiting and len(busy) < self._num:
            if not free:
                free.append(_Worker(self._function, self._is_limited))
                self._workers.append(free[-1])
            busy.append(free.pop())
            busy[-1].give(self._waiting.popleft())
        if self._last and not self._waiting and not busy:
            # Idle workers hold memory, of which there may have been too little.
            self.close()
            self._workers = [_Worker(self._function, self._is_limited)]
            self._workers[0].give(self._last.popleft())

    def _workers_to_hear(self) -> list[_Worker]:
        """Workers that have said something, have died, or have had their time."""
        busy = [worker for worker in self._workers if worker.task is not None]
        left = [
            self._time_of(worker.task) - worker.seconds_used() for worker in busy if worker.began
        ]
        ready = wait([worker.pipe for worker in busy], max(min([_LONGEST_WAIT, *left]), 0.0))
        return [worker for worker in busy if worker.pipe in ready or self._is_late(worker)]

    def _is_late(self, worker: _Worker) -> bool:
        return worker.began > 0 and worker.seconds_used() >= self._time_of(worker.task)

    def _time_of(self, task: _Task | None) -> float:
        if self._limit is None or task is None:
            return float("inf")
        left = self._limit - task.spent
        return left * _SHARE if task.tries < self._most_tries - 1 else max(left, 1.0)

    def _over(self, worker: _Worker) -> _Task | None:
        """The task of a worker, if it is over for good, with what became of it."""
        task = worker.task
        assert task is not None
        if not worker.pipe.poll() and worker.began:
            return self._retry_or_give_up(worker, is_late=True)
        try:
            said = worker.pipe.recv()
        except (EOFError, OSError):
            return self._retry_or_give_up(worker)
        if isinstance(said, float):
            self._num_unborn = 0
            worker.began = time.monotonic()
            worker.cpu_before = said
            return None
        worker.task = None
        worker.began = 0.0
        task.add_cost(said.seconds, said.cpu_seconds, said.cpu_seconds)
        if said.error is not None:
            raise said.error
        task.outcome.result = said.result
        task.outcome.fault = ""
        return task

    def _retry_or_give_up(self, worker: _Worker, is_late: bool = False) -> _Task | None:
        """The task of a worker that has died, or has to, if it is not tried again."""
        task = worker.task
        assert task is not None
        self._workers.remove(worker)
        seconds = time.monotonic() - worker.began if worker.began else 0.0
        used = worker.seconds_used() if worker.began else 0.0
        cpu_seconds = worker.wait_for_end(is_late)
        if not worker.began and worker.exit_code != _KILLED:
            self._check_start(worker)
            self._waiting.appendleft(task.again(task.job))
            return None
        task.tries += 1
        task.add_cost(seconds, cpu_seconds if worker.began else 0.0, used)
        outcome = task.outcome
        outcome.is_late = is_late
        outcome.is_killed = not is_late and worker.exit_code == _KILLED
        late = f"it was not done after {task.spent:.{0 if task.spent >= 10 else 1}f} s"
        outcome.fault = late if is_late else death(worker.exit_code)
        if task.tries >= (2 if outcome.is_killed else self._most_tries):
            return task
        if outcome.is_killed:
            self._last.append(task.again(task.job, is_alone=True))
        elif self._again is not None:
            self._waiting.appendleft(task.again(self._again(task.job, outcome.fault)))
        return None

    def _check_start(self, worker: _Worker) -> None:
        self._num_unborn += 1
        if self._num_unborn >= _MOST_UNBORN:
            raise ClutterGenError(
                f"worker processes end before they begin: {death(worker.exit_code)}",
                hint='in a script of your own, calling it below `if __name__ == "__main__":`',
            )


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


@dataclass
class _Task:
    """One job, its tries so far, and what became of the last."""

    index: int
    job: Any
    is_alone: bool = False
    tries: int = 0
    spent: float = 0.0
    outcome: Outcome = field(default_factory=Outcome)

    def add_cost(self, seconds: float, cpu_seconds: float, used: float) -> None:
        self.outcome.seconds += seconds
        self.outcome.cpu_seconds += cpu_seconds
        self.spent += used

    def again(self, job: Any, is_alone: bool = False) -> _Task:
        """Of time, what was spent counts, but not in the company of others that took the memory."""
        cost = Outcome(seconds=self.outcome.seconds, cpu_seconds=self.outcome.cpu_seconds)
        return _Task(self.index, job, is_alone, self.tries, 0.0 if is_alone else self.spent, cost)


class _Worker:
    """A spawned process.

    Attributes:
      pipe: to it.
      task: what it does; None if nothing.
      began: when it began that, on the monotonic clock; 0 if it has not.
      cpu_before: processor seconds that it had used by then.
    """

    def __init__(self, function: Callable[[Any], Any], is_limited: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, is_limited), daemon=True)
        self._process.start()
        theirs.close()
        self.task: _Task | None = None
        self.began = self.cpu_before = 0.0
        self._say(function)

    @property
    def exit_code(self) -> int | None:
        return self._process.exitcode

    def give(self, task: _Task) -> None:
        self.task = task
        self.began = 0.0
        self._say(task.job)

    def _say(self, what: Any) -> None:
        # If it has died, that is found when it is listened to.
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send(what)

    def seconds_used(self) -> float:
        """Seconds of its task so far: the processor's, where the system reports them."""
        passed = time.monotonic() - self.began
        cpu = _cpu_seconds(self._process.pid)
        return passed if cpu is None else max(cpu - self.cpu_before, passed / _PATIENCE)

    def kill(self) -> None:
        """Ends it, whatever it does."""
        self._process.kill()
        self._process.join()

    def wait_for_end(self, is_late: bool) -> float:
        """Processor seconds of its task, once it is over; 0 where the system does not say.

        Args:
          is_late: it has to be killed.
        """
        before = os.times()
        if is_late:
            self._process.kill()
        self._process.join()
        after = os.times()
        used = (
            after.children_user
            + after.children_system
            - before.children_user
            - before.children_system
        )
        return max(used - self.cpu_before, 0.0)


def _cpu_seconds(pid: int | None) -> float | None:
    """Processor seconds of a process so far; None where the system does not report them."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


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


def _serve(pipe: Connection, is_limited: bool) -> None:
    """In a worker: first the function comes, then jobs, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # One thread each, and no GPU; before anything heavy is loaded, as the function and the jobs do.
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["JAX_PLATFORMS"] = "cpu"
    if is_limited:
        limit_memory()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        function = pipe.recv()
        while True:
            job = pipe.recv()
            # It has a job and all that it needs for it.
            pipe.send(time.process_time())
            pipe.send(_run_job(function, job))
    except EOFError:
        return


def _run_job(function: Callable[[Any], Any], job: Any) -> _Done:
    start = time.perf_counter()
    cpu_start = time.process_time()
    result = None
    failure = None
    try:
        result = function(job)
    except Exception as error:
        failure = error
    return _Done(result, failure, time.perf_counter() - start, time.process_time() - cpu_start)


def _end_with_parent() -> None:
    """A parent that was killed ends nobody, and a worker at work does not hear that it is gone."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
