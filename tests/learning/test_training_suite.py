"""The suite: which runs, in which order, what is skipped, taken up, and what Ctrl-C leaves."""

import numpy as np

from cluttergen_jax.cli.main import main
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.policies.embedded import FOR_ANY_POOL
from cluttergen_jax.learning.ppo.checkpoint import save_policy, save_state
from cluttergen_jax.learning.training.suite import (
    DEFAULT_ATTEMPTS,
    POOLS,
    TABLE_ATTEMPTS,
    PlannedRun,
    plan,
)
from cluttergen_jax.learning.training.suite_run import config_of
from cluttergen_jax.learning.training.train import TrainConfig, recipe_of
from cluttergen_jax.placement.methods.table import LEARNED
from studies.suites import Scale, find_suite

POLICIES = set(LEARNED) - set(FOR_ANY_POOL)


def planned(trial: Trial) -> PlannedRun:
    """The run that a trial's policy comes from: the paper's are trained with five attempts, whatever they are
    allowed later on."""
    attempts = trial.spec.max_attempts if trial.method == "policy" else DEFAULT_ATTEMPTS
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


def finish_run(args, updates, is_whole=True):
    """What a run of `args` leaves after so many updates."""
    settings = args.settings()
    recipe = recipe_of(args, settings)
    args.folder.mkdir(parents=True, exist_ok=True)
    save_state(args.folder / "last", {"x": np.ones(2)}, recipe | {"num_updates": updates})
    known = {"evaluation": {"success": 0.5}} if is_whole else {}
    save_policy(
        args.folder / "policy",
        {"params": {"actor": np.ones(2)}},
        recipe | {"success": 0.25} | known,
    )
    (args.folder / "progress.csv").write_text(
        "update,attempts,attempts_per_second\n0,2048,1000.0\n"
    )


def contents(folder):
    """Every file below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_done_is_left_alone_and_other_settings_are_refused(tmp_path, capsys):
    command = [
        "train",
        "--suite",
        "paper",
        "--suite-only",
        "dining-policy-0",
        "--out",
        str(tmp_path),
    ]
    (run,) = plan("paper", only="dining-policy-0")
    config = config_of(TrainConfig(), run, tmp_path)
    finish_run(config, config.settings().ppo.num_updates)
    before = contents(tmp_path)
    assert main(command) == 0
    assert main([*command, "--num-attempts", "9999"]) == 2
    assert "another ppo" in capsys.readouterr().err
    assert contents(tmp_path) == before
