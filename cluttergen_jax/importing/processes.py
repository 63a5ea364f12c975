"""Spawned worker processes that survive a crash and a Ctrl-C. Imports nothing heavy."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

CRASHED = "the worker process crashed, or was killed for want of memory"


def run_all(
    function: Callable[[Any], str], jobs: Sequence[Any], num_processes: int
) -> Iterator[tuple[int, str]]:
    """Yields (index, result) of `function(job)` as they come, from spawned processes.

    When a worker dies, the jobs that were not finished are run again, each in a process of its own, so that
    only the one to blame is lost: its result is `CRASHED`. Left early, as by Ctrl-C, it ends its workers.
    """
    done: set[int] = set()
    for index, result in _batch(function, jobs, range(len(jobs)), num_processes):
        done.add(index)
        yield index, result
    for index in range(len(jobs)):
        if index not in done:
            results = dict(_batch(function, jobs, [index], 1))
            yield index, results.get(index, CRASHED)


def _batch(
    function: Callable[[Any], str], jobs: Sequence[Any], indices: Sequence[int], num_processes: int
) -> Iterator[tuple[int, str]]:
    """Results until all are there or a worker dies."""
    if not indices:
        return
    executor = ProcessPoolExecutor(
        min(num_processes, len(indices)), multiprocessing.get_context("spawn"), initializer=_prepare
    )
    before = set(multiprocessing.active_children())
    is_finished = False
    try:
        futures = {executor.submit(function, jobs[index]): index for index in indices}
        for future in as_completed(futures):
            try:
                yield futures[future], future.result()
            except BrokenProcessPool:
                break
        is_finished = True
    finally:
        executor.shutdown(wait=is_finished, cancel_futures=True)
        if not is_finished:
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()


def _prepare() -> None:
    """In a worker, before anything heavy is loaded: one thread each, no GPU, Ctrl-C left to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ["JAX_PLATFORMS"] = "cpu"
