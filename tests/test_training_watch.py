"""How a run is watched over: memory, display, records, evaluations, Weights & Biases, Ctrl-C."""

import io
import json
import os
import signal
import sys
import types

import numpy as np
import pytest

from cluttergen_jax.agent.checkpoint import read_record
from cluttergen_jax.agent.config import PPOConfig
from cluttergen_jax.errors import ConfigError, MissingExtraError
from cluttergen_jax.training.display import WIDTH, Display, clock_text, short
from cluttergen_jax.training.interrupt import Interrupt
from cluttergen_jax.training.memory import Needs, amount, check_memory, free_bytes
from cluttergen_jax.training.records import Records, read_rows
from cluttergen_jax.training.wandb_log import WandbLog
from tests.runs import PPO, Stopping, compiled_once, make_run

__all__ = ["compiled_once"]

ROW = {
    "update": 10.0,
    "attempts": 107_000.0,
    "attempts_per_second": 752.3,
    "success": 0.72,
    "num_placed": 8.913,
    "stable_steps": 412.4,
    "reward": -0.4123,
    "loss": 0.1324,
    "value_loss": 1234.082,
    "entropy": -13.211,
    "kl": 0.01234,
    "clipped": 0.212,
    "gradient_norm": 1.323,
}


def needs(**changes):
    config = PPOConfig(num_envs=128, num_steps=16, num_minibatches=8)
    given = {"env": 5_000, "transition": 2_000, "remembered": 250_000, "weights": 4_000_000}
    return Needs(config, **given | changes, engine=lambda num: num * 1_000_000)


def test_memory_is_counted_by_hand():
    memory = needs().memory(128)
    assert memory.rollout == 3 * 128 * 5_000 + 16 * 128 * 2_000
    assert memory.minibatch == 256 * 252_000
    assert memory.weights == 32_000_000
    assert memory.engine == 128_000_000
    assert memory.total == 1_920_000 + 4_096_000 + 64_512_000 + 160_000_000 + memory.programs


def test_run_that_will_not_fit_is_refused_with_the_size_that_would():
    whole = needs()
    limit = whole.memory(64).total + 100
    with pytest.raises(ConfigError, match=r"128 environments .* rollout .* engine .*num_envs=64") as error:
        check_memory(whole, limit)
    assert amount(limit) in str(error.value)
    fitting = whole.fitting(limit)
    assert whole.memory(fitting).total <= limit < whole.memory(fitting + 1).total
    assert "free" in check_memory(whole, whole.memory(128).total)
    with pytest.raises(ConfigError, match="not one environment"):
        check_memory(whole, 1000)


def test_size_that_fits_divides_evenly():
    config = PPOConfig(num_envs=24, num_steps=1, num_minibatches=6)
    odd = Needs(config, 0, 0, 0, 0, lambda num: 100 * num, num_devices=4)
    base = odd.memory(0).total
    assert odd.fitting(base + 100 * 5) == 12
    assert odd.fitting(base + 100 * 6) == 24


def test_several_devices_share_the_engine_and_the_minibatch():
    one, two = needs(), needs(num_devices=2)
    assert two.memory(128).engine * 2 == one.memory(128).engine
    assert two.memory(128).minibatch * 2 == one.memory(128).minibatch
    assert two.memory(128).weights == one.memory(128).weights


def test_run_refuses_before_it_compiles(tmp_path):
    run = make_run(tmp_path / "run", memory_limit=1000)
    with pytest.raises(ConfigError, match="4 environments of 4 steps need"):
        run.train()
    assert not (tmp_path / "run" / "last").exists()
    assert free_bytes() > 10_000_000


def test_more_environments_need_more(tmp_path):
    small = make_run(tmp_path / "a", memory_limit=1 << 62).memory()
    large = make_run(tmp_path / "b", PPOConfig(num_envs=4096, num_steps=64), memory_limit=1 << 62).memory()
    assert all(part in small for part in ("rollout", "minibatch", "weights", "engine"))
    assert float(large.split()[0]) < float(small.split()[0])
    assert large.split()[1] == "GB:"
    assert small.split()[1] == "MB:"


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(stream, rows, seconds=1.0, total=250_000):
    now = iter(np.arange(0, 1000, seconds))
    display = Display(total, 0, stream, clock=lambda: float(next(now)))
    display.begin()
    for row in rows:
        display.show(row)
    display.say("a word")
    display.close()
    return stream.getvalue()


def test_terminal_has_two_lines_of_figures_in_a_hundred_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "101")
    text = shown(Terminal(), [ROW, ROW])
    drawn = text.replace("\x1b[K", "").split("\x1b[1A\r")[0].lstrip("\r").split("\n")
    assert len(drawn) == 2
    assert all(len(line) <= WIDTH for line in drawn)
    assert all(word in drawn[0] for word in ("43%", "107k/250k", "752/s", "left", "0.72", "8.91", "412"))
    assert all(word in drawn[1] for word in ("loss 0.132", "value", "entropy", "KL", "clipped"))
    assert text.rstrip().endswith("a word")


def test_log_gets_a_line_every_ten_seconds_and_the_last():
    text = shown(io.StringIO(), [ROW] * 30, seconds=0.5)
    lines = [line for line in text.splitlines() if "entropy" in line]
    assert 2 <= len(lines) <= 5
    assert "\x1b" not in text
    assert shown(io.StringIO(), [ROW, ROW | {"attempts": 250_000.0}], seconds=0.01).count("entropy") == 2


def test_time_left_is_counted_from_what_this_session_made():
    now = iter([0.0, 100.0, 110.0, 110.0, 110.0])
    stream = io.StringIO()
    display = Display(2000, 1000, stream, clock=lambda: next(now))
    display.begin()
    display.show({"attempts": 1500.0, "attempts_per_second": 50.0})
    assert "75% 1500/2k" in stream.getvalue() or "75% 1.5k/2k" in stream.getvalue()
    assert "0:10 left" in stream.getvalue()


@pytest.mark.parametrize(
    ("number", "text"), [(0, "0"), (950, "950"), (12_345, "12.3k"), (250_000, "250k"), (2.5e6, "2.5M")]
)
def test_counts_are_short(number, text):
    assert short(number) == text


def test_durations_are_words():
    assert [clock_text(s) for s in (5, 754, 12_000)] == ["0:05", "12:34", "3 h 20 min"]


def test_records_are_continued_and_a_torn_row_is_left_out(tmp_path):
    path = tmp_path / "progress.csv"
    records = Records(path)
    for update in range(4):
        records.add({"update": update, "attempts": 16 * update, "success": update / 3})
    with path.open("a") as file:
        file.write("4,64")
    assert [row["update"] for row in read_rows(path)] == [0, 1, 2, 3]
    again = Records(path, 2)
    again.add({"update": 2, "attempts": 32, "success": 0.9})
    assert [row["success"] for row in read_rows(path)] == [0.0, 1 / 3, 0.9]


class FakeRun:
    def __init__(self):
        self.rows, self.is_finished = [], False

    def log(self, row, step):
        self.rows.append((step, row))

    def finish(self):
        self.is_finished = True


def test_wandb_gets_every_row_and_the_same_id_again(tmp_path, monkeypatch):
    calls, fake = [], FakeRun()
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


def test_missing_wandb_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(MissingExtraError, match=r"cluttergen_jax\[wandb\]"):
        WandbLog(tmp_path, {})


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
def test_evaluations_stand_beside_trainings_own_check(tmp_path):
    evaluate, given = evaluations()
    said = []
    folder = tmp_path / "run"
    run = make_run(folder, evaluate=evaluate, eval_every=PPO.batch_size)
    run.train(show=said.append)
    assert len(given) == 4
    rows = read_rows(folder / "evaluations.csv")
    assert [row["attempts"] for row in rows] == [16, 32, 48, 64]
    np.testing.assert_allclose([row["success"] for row in rows], [0.1, 0.2, 0.3, 0.4])
    record = read_record(folder / "policy")["evaluation"]
    assert record["success"] == pytest.approx(0.4)
    assert record["action"] == "sampled"
    assert record["training_success"] == np.mean(
        [row["success"] for row in read_rows(folder / "progress.csv")[-2:]]
    )
    spoken = [line for line in said if line.startswith("evaluation")]
    assert len(spoken) == 4
    own = f"training's check {record['training_success']:.3f}"
    assert f"{own}, whole last check 0.400 [0.350, 0.450] (256 episodes" in spoken[-1]
    assert said[0].startswith("memory")
    # What is done is not done again.
    make_run(folder, evaluate=evaluate).train(show=said.append)
    assert len(given) == 4


def test_evaluation_that_was_missed_is_made_up_for(tmp_path):
    evaluate, given = evaluations()
    folder = tmp_path / "run"
    make_run(folder).train()
    assert "evaluation" not in read_record(folder / "policy")
    make_run(folder, evaluate=evaluate).train()
    assert len(given) == 1
    assert read_record(folder / "policy")["evaluation"]["episodes"] == 256


def test_interrupted_run_is_not_evaluated(tmp_path):
    evaluate, given = evaluations()
    with pytest.raises(KeyboardInterrupt):
        make_run(tmp_path / "run", evaluate=evaluate).train(interrupt=Stopping(1))
    assert given == []
    assert json.loads((tmp_path / "run" / "last" / "record.json").read_text())["num_updates"] == 1
