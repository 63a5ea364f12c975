"""What is said while something long runs, and how Ctrl-C is answered meanwhile."""

import io
import signal
import threading

import pytest

from cluttergen_jax.progress import Progress, interruptible


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
