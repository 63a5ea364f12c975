"""What is said while something long runs, and how Ctrl-C is answered meanwhile."""

import io
import itertools
import signal
import threading

import pytest

from cluttergen_jax import progress
from cluttergen_jax.progress import Progress, interruptible, passed_text, waiting


class Shown(io.StringIO):
    """What was shown, as a terminal or a log; one may wait until it was shown some text."""

    def __init__(self, is_terminal=False):
        super().__init__()
        self.isatty = lambda: is_terminal
        self._change = threading.Condition()

    def write(self, text):
        with self._change:
            super().write(text)
            self._change.notify_all()
        return len(text)

    def wait_for(self, text):
        with self._change:
            assert self._change.wait_for(lambda: text in self.getvalue(), timeout=60)


@pytest.fixture(autouse=True)
def quick_ticks(monkeypatch):
    monkeypatch.setattr(progress, "_TICK", 0.001)


def seconds_of_eleven():
    """A clock that goes on by eleven seconds each time it is asked."""
    return itertools.count(0.0, 11.0).__next__


# What waits


def test_a_log_goes_on_while_nothing_gets_done_and_names_what_is_at_work():
    log = Shown()
    with Progress("importing", 1, "object", file=log, clock=seconds_of_eleven()) as shown:
        shown.note("at work: scan (cutting 4,600 triangles)")
        log.wait_for("importing: 0 of 1 objects, 3 min")
        shown.update()
    lines = log.getvalue().splitlines()
    waits = [line for line in lines if "at work: scan (cutting 4,600 triangles)" in line]
    assert len(waits) > 3
    assert len(set(waits)) == len(waits)
    assert lines[-1].startswith("importing: 1 of 1 objects done in ")


def test_an_estimate_leaves_out_what_was_compiled_first():
    seconds = 0.0
    shown = Progress("learning", 11, "step", file=io.StringIO(), clock=lambda: seconds)
    seconds = 3600.0
    shown.update()
    assert shown.times() == "60 min 0 s passed, 10.0 h left"
    shown.begin_timing()
    assert "left" not in shown.times()
    seconds += 2.0
    shown.update()
    assert shown.times() == "60 min 2 s passed, 18 s left"


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_wait_names_its_phase_its_reason_and_its_seconds(is_terminal):
    shown = Shown(is_terminal)
    clock = seconds_of_eleven()
    with waiting("compiling", "half a minute where it is new", file=shown, clock=clock):
        shown.wait_for("compiling: half a minute where it is new")
        shown.wait_for("compiling: 00:00 passed" if is_terminal else "compiling: 33 s passed")
    assert is_terminal or "compiling: done in " in shown.getvalue().splitlines()[-1]


def test_a_wait_that_fails_says_nothing_of_being_done():
    log = Shown()

    def interrupted():
        with waiting("compiling", "a minute", file=log, clock=seconds_of_eleven()):
            log.wait_for("passed")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert "done" not in log.getvalue()


def test_the_first_line_of_a_wait_goes_where_it_is_told():
    log = Shown()
    said = []
    with waiting("preparing", "all environments", said.append, log):
        pass
    assert said == ["preparing: all environments"]
    assert not log.getvalue()


def test_a_time_that_goes_on_has_seconds_for_an_hour_and_a_half():
    times = [passed_text(seconds) for seconds in (12, 89, 130, 140, 5399, 7200)]
    assert times == ["12 s", "89 s", "2 min 10 s", "2 min 20 s", "89 min 59 s", "2.0 h"]


# Ctrl-C


@pytest.fixture
def answers_ctrl_c():
    """A process that a script has put into the background ignores Ctrl-C, and so would the tests."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("answers_ctrl_c")
def test_ctrl_c_does_not_wait_for_a_long_call():
    is_running = threading.Event()
    is_over = threading.Event()

    def long_call():
        is_running.set()
        is_over.wait()

    def strike(thread):
        is_running.wait()
        signal.pthread_kill(thread.ident, signal.SIGINT)

    striker = threading.Thread(target=strike, args=(threading.main_thread(),))
    striker.start()
    with pytest.raises(KeyboardInterrupt):
        interruptible(long_call)
    striker.join()
    is_over.set()
