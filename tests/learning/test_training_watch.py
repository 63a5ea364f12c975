"""How a run is watched over: memory, metrics, evaluations, Weights & Biases, Ctrl-C."""

import os
import signal
import sys
import types

import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training.run_folder import Interrupt
from cluttergen_jax.learning.training.run_logger import MetricsLog, WandbLog, read_rows
from tests.helpers.runs import make_run


def test_a_log_is_continued_and_a_torn_row_is_left_out(tmp_path):
    path = tmp_path / "progress.csv"
    log = MetricsLog(path)
    for update in range(4):
        log.add({"update": update, "attempts": 16 * update, "success": update / 3})
    with path.open("a") as file:
        file.write("4,64")
    assert [row["update"] for row in read_rows(path)] == [0, 1, 2, 3]
    again = MetricsLog(path, 2)
    again.add({"update": 2, "attempts": 32, "success": 0.9})
    assert [row["success"] for row in read_rows(path)] == [0.0, 1 / 3, 0.9]


class FakeRun:
    def __init__(self):
        self.rows = []
        self.is_finished = False

    def log(self, row, step):
        self.rows.append((step, row))

    def finish(self):
        self.is_finished = True


def test_wandb_gets_every_row_and_the_same_id_again(tmp_path, monkeypatch):
    calls = []
    fake = FakeRun()
    stub = types.SimpleNamespace(init=lambda **options: calls.append(options) or fake)
    monkeypatch.setitem(sys.modules, "wandb", stub)
    log = WandbLog(tmp_path, {"pool": "dining"})
    log.add({"attempts": 16, "success": 0.5}, "")
    log.add({"attempts": 16, "success": 0.25}, "evaluation/")
    log.close()
    WandbLog(tmp_path, {"pool": "dining"})
    assert fake.rows[0] == (16, {"attempts": 16, "success": 0.5})
    assert fake.rows[1] == (16, {"evaluation/attempts": 16, "evaluation/success": 0.25})
    assert fake.is_finished
    assert calls[0] == calls[1]
    assert calls[0]["config"] == {"pool": "dining"}
    assert calls[0]["resume"] == "allow"


def test_first_interrupt_asks_and_the_second_strikes():
    before = signal.getsignal(signal.SIGINT)
    with Interrupt() as interrupt:
        assert not interrupt.is_asked
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.is_asked
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def evaluations():
    """An evaluator that says a different success each time, and remembers what it was given."""
    given = []

    def evaluate(params):
        given.append(params)
        success = 0.1 * len(given)
        interval = {"low95": success - 0.05, "high95": success + 0.05}
        return {"success": success, **interval, "episodes": 256, "action": "sampled"}

    return evaluate, given


@pytest.mark.slow
def test_a_run_is_evaluated_once_and_stored_with_what_was_found(tmp_path):
    evaluate, given = evaluations()
    for _ in range(2):
        make_run(tmp_path / "run", evaluate=evaluate).train()
    assert len(given) == 1
    assert read_record(tmp_path / "run" / "policy")["evaluation"]["success"] == pytest.approx(0.1)
    with pytest.raises(ConfigError, match="needs"):
        make_run(tmp_path / "small", memory_limit=1000).train()
