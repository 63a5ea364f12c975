"""What is said while something long runs, and how Ctrl-C is answered meanwhile."""

import io
import signal
import threading

import pytest

from cluttergen_jax import progress
from cluttergen_jax.progress import Progress, interruptible, time_text, track


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Clock:
    """Seconds that pass when told to."""

    now = 0.0

    def __call__(self):
        return self.now


def test_a_log_gets_a_line_every_ten_seconds_and_one_at_the_end():
    log, clock = io.StringIO(), Clock()
    with Progress("drawing", 4, "picture", file=log, clock=clock) as shown:
        for _ in range(4):
            clock.now += 6.0
            shown.update(note="loss 0.5")
    assert log.getvalue().splitlines() == [
        "drawing: 2 of 4 pictures, 12 s passed, 12 s left, loss 0.5",
        "drawing: 4 of 4 pictures, 24 s passed, 0 s left, loss 0.5",
        "drawing: 4 of 4 pictures done in 24 s",
    ]


def test_what_is_at_work_is_named_while_nothing_gets_done():
    log, terminal, clock = io.StringIO(), Terminal(), Clock()
    with Progress("importing", 4, "object", file=log, clock=clock) as shown:
        for _ in range(25):
            clock.now += 1.0
            shown.note("at work: mug")
    assert log.getvalue().splitlines()[:2] == [
        "importing: 0 of 4 objects, 10 s passed, at work: mug",
        "importing: 0 of 4 objects, 20 s passed, at work: mug",
    ]
    with Progress("importing", 4, "object", file=terminal) as shown:
        shown.note("at work: mug")
    assert "at work: mug" in terminal.getvalue()


def test_what_was_done_before_is_counted_but_sets_no_pace():
    log, clock = io.StringIO(), Clock()
    with Progress("learning", 100, "step", kept=90, file=log, clock=clock) as shown:
        clock.now += 20.0
        shown.update(2)
        clock.now += 1.0
        shown.update(8)
    assert log.getvalue().splitlines()[0] == "learning: 92 of 100 steps, 20 s passed, 80 s left"


def test_quick_work_leaves_a_log_alone(capsys):
    assert list(track([1, 2, 3], "drawing", 3, "picture")) == [1, 2, 3]
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_a_bar():
    terminal = Terminal()
    with Progress("drawing", 2, "picture", file=terminal) as shown:
        shown.say("a line that stays")
        shown.update(2)
    assert "100%" in terminal.getvalue()
    assert "a line that stays\n" in terminal.getvalue()
    assert "passed" not in terminal.getvalue()


def test_lengths_of_time_are_for_people():
    assert [time_text(each) for each in (5, 150, 9000)] == ["5 s", "2 min", "2.5 h"]


def test_nothing_to_do_draws_no_bar():
    terminal = Terminal()
    Progress("drawing", 0, "picture", file=terminal).say("a line")
    assert terminal.getvalue() == "a line\n"


# Ctrl-C


@pytest.fixture
def answers_ctrl_c():
    """A process that a script has put into the background ignores Ctrl-C, and so would the tests."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("answers_ctrl_c")
def test_ctrl_c_does_not_wait_for_a_long_call():
    is_running, is_over = threading.Event(), threading.Event()

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


def test_an_interrupt_that_was_swallowed_is_raised_again(monkeypatch):
    monkeypatch.setattr(progress, "stop_asked", threading.Event())
    progress.stop_asked.set()
    with pytest.raises(KeyboardInterrupt):
        interruptible(divmod, 7, 2)


def test_results_and_errors_come_through():
    assert interruptible(divmod, 7, 2) == (3, 1)
    with pytest.raises(ZeroDivisionError):
        interruptible(divmod, 7, 0)
