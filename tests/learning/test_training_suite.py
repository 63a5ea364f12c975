"""The suite: which runs, in which order, what is skipped, taken up, and what Ctrl-C leaves."""

from cluttergen_jax.config import VARIANTS
from cluttergen_jax.evaluation.suites import Scale, find_suite
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.policies.embedded import FOR_ANY_POOL
from cluttergen_jax.learning.training.suite import (
    DEFAULT_ATTEMPTS,
    POOLS,
    TABLE_ATTEMPTS,
    PlannedRun,
    plan,
)

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
