"""What a terminal asks for: Ctrl-C and SIGTERM end the process within seconds, and NO_COLOR is heeded."""

import signal
import subprocess
import sys
import threading

import pytest

from cluttergen_jax.learning.training.run_folder import Interrupt

# A call that takes minutes and answers no signal, as a compilation does.
BUSY = """
import hashlib, signal, threading
from contextlib import nullcontext
from cluttergen_jax.cli import main
from cluttergen_jax.learning.training.run_folder import Interrupt
main.GRACE = 0.4
signal.signal(signal.SIGINT, main._on_interrupt)
main.watch_signals(main._on_interrupt)
with {context}:
    # Said from within the call: a signal before it would be answered by Python itself.
    threading.Timer(0.5, print, ["ready"], {{"flush": True}}).start()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
"""


def busy(context):
    process = subprocess.Popen(
        [sys.executable, "-c", BUSY.format(context=context)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    return process


def test_ctrl_c_ends_what_does_not_answer():
    process = busy("nullcontext()")
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 130


# Ctrl-C comes while a module is loaded.
LOADING = """
import signal, sys, time
from cluttergen_jax.cli import main
signal.signal(signal.SIGINT, main._on_interrupt)
sys.path.insert(0, {folder!r})
import slow_module
assert slow_module.is_loaded
print("loaded", flush=True)
try:
    time.sleep(20)
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


def test_ctrl_c_while_a_module_is_loaded_waits_for_it(tmp_path):
    (tmp_path / "slow_module.py").write_text(
        "import signal\nsignal.raise_signal(signal.SIGINT)\nis_loaded = True\n"
    )
    code = LOADING.format(folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.stdout, done.returncode) == ("loaded\nstopped\n", 0), done.stderr


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_what_saves_first_is_waited_for_until_it_is_asked_again(number, status):
    process = busy("Interrupt()")
    process.send_signal(number)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(1)
    process.send_signal(number)
    assert process.wait(20) == status


def test_a_compilation_before_which_nothing_is_to_be_saved_is_not_waited_for():
    is_over = threading.Event()
    before = signal.getsignal(signal.SIGTERM)

    def compilation():
        signal.pthread_kill(threading.main_thread().ident, signal.SIGTERM)
        is_over.wait()

    with pytest.raises(KeyboardInterrupt), Interrupt() as interrupt:
        interrupt.run_compiling(compilation)
    is_over.set()
    assert signal.getsignal(signal.SIGTERM) is before
    with Interrupt() as interrupt:
        assert interrupt.run_compiling(divmod, 7, 2) == (3, 1)
