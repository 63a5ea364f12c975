"""What is said while something long runs, and how Ctrl-C is answered meanwhile."""

import signal
import threading

import pytest

from cluttergen_jax.progress import interruptible

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
