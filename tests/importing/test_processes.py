"""Worker processes: results come back by index, a crash costs one job, an early exit leaves no worker."""

import multiprocessing
import os
import signal
import time

from cluttergen_jax.importing.processes import CRASHED, run_all


def reciprocal(number):
    """Kills its own process if the number is zero."""
    if number == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return str(1 / number)


def environment(name):
    return os.environ.get(name, "")


def sleep(seconds):
    time.sleep(seconds)
    return ""


def test_a_crash_costs_only_its_own_job():
    results = dict(run_all(reciprocal, [1, 2, 0, 4], 1))
    assert results == {0: "1.0", 1: "0.5", 2: CRASHED, 3: "0.25"}


def test_workers_take_one_thread_and_no_gpu():
    results = dict(run_all(environment, ["OMP_NUM_THREADS", "JAX_PLATFORMS"], 2))
    assert results == {0: "1", 1: "cpu"}


def test_leaving_early_ends_the_workers():
    results = run_all(sleep, [0, 60, 60], 1)
    assert next(results) == (0, "")
    start = time.perf_counter()
    results.close()
    for process in multiprocessing.active_children():
        process.join(10)
    assert time.perf_counter() - start < 20
    assert not multiprocessing.active_children()


def test_no_jobs_need_no_process():
    assert list(run_all(reciprocal, [], 4)) == []
