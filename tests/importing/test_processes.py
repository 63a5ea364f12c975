"""Worker processes: results come back by index, a crash costs one job, an early exit leaves no worker.

So does a job without an end. What ended a worker is told.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.importing.limited import Crew, run_all
from cluttergen_jax.phases import say_phase


def reciprocal(number):
    """Kills its own process if the number is zero."""
    if number == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return str(1 / number)


def end(how):
    """Ends its own process by a signal, or with a status, or computes for ever; or returns what it is."""
    if how == "spin":
        while True:
            pass
    if isinstance(how, signal.Signals):
        os.kill(os.getpid(), how)
    if isinstance(how, int):
        os._exit(how)
    return how


def spin_named(folder):
    """Says which process it is, and computes for ever."""
    Path(folder, str(os.getpid())).touch()
    end("spin")


def cut(file):
    """Says what it is at, and waits until a file is there, which shows that it was heard."""
    say_phase(f"cutting {file.name}")
    while not file.exists():
        time.sleep(0.01)
    return "done"


def plain(job, fault):
    """A second job in the place of one that was lost."""
    return f"second try after: {fault}"


class Unborn:
    """A job that ends the process that unpickles it."""

    def __reduce__(self):
        return os._exit, (7,)


def outcomes(jobs, **options):
    crew = Crew(end, 2, **options)
    try:
        return dict(crew.outcomes(jobs))
    finally:
        crew.close()


def test_a_worker_says_what_it_is_at(tmp_path):
    heard = []

    def watch(phases):
        heard.append(phases)
        for phase in phases.values():
            if phase:
                (tmp_path / phase.removeprefix("cutting ")).touch()

    crew = Crew(cut, 2, watch=watch)
    try:
        done = dict(crew.outcomes([tmp_path / "cup", tmp_path / "scan"]))
    finally:
        crew.close()
    assert [done[index].result for index in (0, 1)] == ["done", "done"]
    assert {phase for phases in heard for phase in phases.items() if phase[1]} == {
        (0, "cutting cup"),
        (1, "cutting scan"),
    }


def test_a_crash_costs_only_its_own_job():
    results = dict(run_all(reciprocal, [1, 2, 0, 4], 1))
    lost = results.pop(2)
    assert results == {0: "1.0", 1: "0.5", 3: "0.25"}
    assert "SIGKILL" in lost
    assert "memory" in lost


@pytest.mark.parametrize("how", ["spin", signal.SIGSEGV])
def test_a_lost_job_is_tried_once_more_in_another_way(how):
    found = outcomes([how], limit=0.6, again=plain)[0]
    assert not found.fault
    assert found.result.startswith("second try after: it")
    found = outcomes([how], limit=0.6, again=lambda job, fault: job)[0]
    assert found.fault
    assert found.seconds < 60


def test_workers_that_cannot_begin_end_the_run():
    with pytest.raises(ClutterGenError, match=r"before they begin.*__main__"):
        outcomes([Unborn()])


def is_running(pid):
    """Whether there is such a process, and not only its name in a table that nobody has cleared."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.skipif(sys.platform == "win32", reason="needs signals")
def test_workers_do_not_outlive_a_parent_that_is_killed(tmp_path):
    """A worker that computes for ever hears nothing of its parent's end."""
    code = (
        "from tests.importing.test_processes import spin_named\n"
        "from cluttergen_jax.importing.limited import Crew\n"
        f"jobs = [{str(tmp_path)!r}]\n"
        "next(Crew(spin_named, 1).outcomes(jobs))\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.time() + 60
    while not list(tmp_path.iterdir()) and time.time() < deadline:
        time.sleep(0.05)
    (named,) = tmp_path.iterdir()
    parent.kill()
    parent.wait()
    while is_running(int(named.name)) and time.time() < deadline:
        time.sleep(0.05)
    assert not is_running(int(named.name))
