"""The suite: which runs, in which order, what is skipped, taken up, and what Ctrl-C leaves."""

import shutil
import signal
from dataclasses import replace

import jax
import pytest

from cluttergen_jax import train_suite
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.config import VARIANTS
from cluttergen_jax.evaluation.suites import Scale, find_suite
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.policies.embedded import FOR_ANY_POOL
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training.run import Run, RunConfig
from cluttergen_jax.learning.training.suite import (
    DEFAULT_ATTEMPTS,
    POOLS,
    TABLE_ATTEMPTS,
    PlannedRun,
    plan,
)
from cluttergen_jax.learning.training.train import TrainConfig
from tests.helpers.problems import made_up_rules
from tests.helpers.worlds import box

POLICIES = set(VARIANTS) - set(FOR_ANY_POOL)


def planned(trial: Trial) -> PlannedRun:
    """The run that a trial's policy comes from: the paper's are trained with five attempts, whatever they are
    allowed later on."""
    attempts = trial.attempts if trial.method == "policy" else DEFAULT_ATTEMPTS
    return PlannedRun(trial.pool, trial.method, trial.training_seed, attempts)


def test_tables_are_covered_and_the_first_seed_comes_first():
    runs = plan("paper")
    names = [run.name for run in runs]
    assert len(set(names)) == len(names)
    seeds = [run.seed for run in runs]
    assert seeds == sorted(seeds)
    asked = {
        planned(trial).name
        for study in find_suite("paper", Scale(seeds=3))
        for trial in study.trials
        if trial.method in POLICIES
    }
    assert len(asked) > 3 * len(POOLS)
    assert asked <= set(names)
    dining = {run.attempts for run in runs if run.pool == "dining" and run.variant == "policy"}
    assert dining == set(TABLE_ATTEMPTS)
    assert {run.attempts for run in runs if run.pool != "dining"} == {5}


def contents(folder):
    """Every file below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


PAIR = ("duo-normal-0", "duo-beta_free-0")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_two_real_runs_are_made_stopped_left_alone_and_made_again(home, tmp_path):
    """Nothing is made up here: a pool, two policies, the simulator, a Ctrl-C in the first run."""
    boxes = [box(f"box-{k}", (0.02, 0.02 + 0.002 * k, 0.03)) for k in range(10)]
    write_pool(home / "pools" / "duo", Pool("duo", tuple(boxes)))

    def suite(out="runs", show=lambda text: None, **changed):
        which = {"pools": ("duo",), "seeds": (0,), "suite_only": "duo-[bn]*", "out": tmp_path / out}
        few = {"num_attempts": 200, "num_envs": 4, "eval_episodes": 2, "eval_every": 100}
        return train_suite("paper", show=show, **which | few | changed)

    def interrupting(text):
        if text.startswith("evaluation"):
            signal.raise_signal(signal.SIGINT)

    def words(report):
        return [standing.word for standing in report.standings]

    first, second = (tmp_path / "runs" / name for name in PAIR)
    with pytest.raises(KeyboardInterrupt):
        suite(show=interrupting)
    assert words(suite(suite_list=True)) == ["begun", "to do"]
    assert contents(second) == {}
    begun = read_record(first / "last")["num_updates"]
    assert begun > 0

    assert suite().failed == {}
    assert read_record(first / "last")["num_updates"] == read_record(second / "last")["num_updates"] > begun
    assert [read_record(run / "policy")["evaluation"]["episodes"] for run in (first, second)] == [2, 2]

    made = contents(tmp_path / "runs")
    assert words(suite()) == ["done", "done"]
    assert contents(tmp_path / "runs") == made

    weights = (second / "policy" / "weights.npz").read_bytes()
    of_first = contents(first)
    shutil.rmtree(second)
    assert words(suite()) == ["done", "to do"]
    assert contents(first) == of_first
    assert (second / "policy" / "weights.npz").read_bytes() == weights

    # A run that fails stops no other.
    failed = suite("refused", memory_limit=1e-6).failed
    assert tuple(failed) == PAIR
    assert all("a run that needs" in reason for reason in failed.values())


@pytest.mark.parametrize("attempts", [1, 10])
@pytest.mark.parametrize("variant", sorted(POLICIES))
def test_every_variant_begins_with_one_attempt_and_with_ten(variant, attempts, tmp_path):
    """From the command's settings to the shapes of a whole update."""
    args = TrainConfig(variant=variant, max_attempts=attempts, num_objects=2)
    settings = args.settings()
    ppo = replace(settings.ppo, num_envs=2, num_steps=2, num_minibatches=1, num_epochs=1)
    rules = made_up_rules(2, max_attempts=attempts, num_objects=2, history_stride=60)
    run = Run(rules, settings.network, ppo, RunConfig(), tmp_path / "run", {})
    params = jax.eval_shape(run._init, jax.random.key(0))
    state = jax.eval_shape(run.ppo.start, jax.random.key(0), params)
    after, figures, _ = jax.eval_shape(run.ppo.checked_update, state)
    assert jax.tree.map(lambda leaf: leaf.shape, after) == jax.tree.map(lambda leaf: leaf.shape, state)
    assert "success" in {name.removeprefix("env/") for name in figures}
    if hasattr(settings.network, "history_length"):
        wanted = {"short_memory": 1, "open_loop": attempts}.get(variant, attempts)
        assert settings.network.history_length == wanted
