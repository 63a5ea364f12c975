"""The suite: which runs, in which order, what is skipped, taken up, and what Ctrl-C leaves."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from cluttergen_jax.cli.main import main
from cluttergen_jax.config import VARIANTS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.resolved import Checkpoints
from cluttergen_jax.evaluation.suites import Scale, find_suite
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.ppo.checkpoint import read_record, save_policy, save_state
from cluttergen_jax.learning.training import suite_run
from cluttergen_jax.learning.training.run import Run, RunConfig
from cluttergen_jax.learning.training.suite import POOLS, TABLE_ATTEMPTS, PlannedRun, plan
from cluttergen_jax.learning.training.suite_run import config_of
from cluttergen_jax.learning.training.train import TrainConfig, recipe_of
from cluttergen_jax.placement.baselines import BASELINES
from tests.helpers.problems import made_up_rules


def test_tables_are_covered_and_the_first_seed_comes_first():
    runs = plan("paper")
    names = [run.name for run in runs]
    assert len(set(names)) == len(names)
    seeds = [run.seed for run in runs]
    assert seeds == sorted(seeds)
    asked = {
        PlannedRun(trial.pool, trial.method, trial.training_seed, trial.attempts).name
        for study in find_suite("paper", Scale(seeds=3))
        for trial in study.trials
        if trial.method not in BASELINES
    }
    assert len(asked) > 3 * len(POOLS)
    assert asked <= set(names)
    dining = {run.attempts for run in runs if run.pool == "dining" and run.variant == "policy"}
    assert dining == set(TABLE_ATTEMPTS)
    assert {run.attempts for run in runs if run.pool != "dining"} == {5}


def test_extended_tables_are_covered_with_one_seed():
    runs = plan("extended")
    names = [run.name for run in runs]
    assert len(set(names)) == len(names)
    assert {run.seed for run in runs} == {0}
    asked = {
        PlannedRun(trial.pool, trial.method, trial.training_seed, trial.attempts).name
        for study in find_suite("extended", Scale())
        for trial in study.trials
        if trial.method in VARIANTS
    }
    assert {"dining-ranked-0", "all-policy-0", "all-ranked-0"} <= asked == set(names)
    commands = [config_of(TrainConfig(), run, Path("runs")) for run in runs]
    assert {(args.pool, args.support, args.num_objects) for args in commands if args.variant == "ranked"} == {
        ("dining", "table-0.30x0.40", 10),
        ("all", "table", 20),
    }


def test_the_former_name_of_a_suite_is_understood():
    assert plan("honest") == plan("extended")


def test_pools_seeds_and_patterns_select():
    assert {run.pool for run in plan("paper", pools=("office",))} == {"office"}
    assert {run.seed for run in plan("paper", seeds=(7,))} == {7}
    assert [run.name for run in plan("paper", only="*-normal-1", pools=("study",))] == ["study-normal-1"]
    for wrong in (
        {"suite": "all"},
        {"suite": "paper", "only": "nothing"},
        {"suite": "paper", "seeds": (1, 1)},
    ):
        with pytest.raises(ConfigError):
            plan(**wrong)


def finish_run(args, updates, is_whole=True):
    """What a run of `args` leaves after so many updates."""
    settings = args.settings()
    recipe = recipe_of(args, settings)
    args.folder.mkdir(parents=True, exist_ok=True)
    save_state(args.folder / "last", {"x": np.ones(2)}, recipe | {"num_updates": updates})
    known = {"evaluation": {"success": 0.5}} if is_whole else {}
    save_policy(args.folder / "policy", {"params": {"actor": np.ones(2)}}, recipe | {"success": 0.25} | known)
    (args.folder / "progress.csv").write_text("update,attempts,attempts_per_second\n0,2048,1000.0\n")


@pytest.fixture
def trains(monkeypatch):
    """Runs are only noted, and left as if they had been made; the third one is stopped."""
    made = []

    def train(config, show):
        made.append(config.folder.name)
        if len(made) == 3:
            finish_run(config, 1, is_whole=False)
            raise KeyboardInterrupt
        finish_run(config, config.settings().ppo.num_updates)

    monkeypatch.setattr(suite_run, "run_training", train)
    return made


def test_suite_stops_as_a_whole_and_goes_on_where_it_stopped(trains, tmp_path, capsys):
    command = ["train", "--suite", "paper", "--pools", "dining", "--seeds", "0", "--out", str(tmp_path)]
    names = [run.name for run in plan("paper", ("dining",), (0,))]
    assert main(command) == 130
    assert trains == names[:3]
    assert main([*command, "--suite-list"]) == 0
    listed = capsys.readouterr().out
    assert "2 done" in listed
    assert "the paper: 2,500,000" in listed
    assert "1000 attempts per second, measured" in listed
    words = {line.split()[0]: line.split()[1] for line in listed.splitlines() if line.startswith("  dining")}
    assert words[names[0]] == "done"
    assert words[names[2]] == "begun"
    assert words[names[3]] == "to"
    assert main(command) == 0
    assert trains[3:] == names[2:]
    assert main(command) == 0
    assert len(trains) == len(names) + 1
    budgets = {read_record(tmp_path / name / "last")["ppo"]["num_attempts"] for name in names}
    assert len(budgets) == 1
    assert {read_record(tmp_path / name / "last")["placement"]["max_attempts"] for name in names} == set(
        TABLE_ATTEMPTS
    )


def test_failed_run_does_not_stop_the_others(monkeypatch, tmp_path, capsys):
    made = []

    def train(config, show):
        made.append(config.folder.name)
        if len(made) == 1:
            raise ConfigError("something")
        finish_run(config, config.settings().ppo.num_updates)

    monkeypatch.setattr(suite_run, "run_training", train)
    command = ["train", "--suite", "paper", "--suite-only", "dining-policy*", "--seeds", "0"]
    assert main([*command, "--out", str(tmp_path)]) == 1
    assert len(made) == 5
    assert "failed: dining-policy-0" in capsys.readouterr().err


def test_run_with_other_settings_is_refused_before_anything_begins(trains, tmp_path, capsys):
    command = ["train", "--suite", "paper", "--suite-only", "dining-normal-0", "--out", str(tmp_path)]
    assert main(command) == 0
    assert main([*command, "--num-attempts", "9999"]) == 2
    assert "another ppo" in capsys.readouterr().err
    assert len(trains) == 1


def test_evaluation_finds_the_runs_by_their_names(tmp_path):
    for run in plan("paper", ("dining",), (0, 2)):
        args = TrainConfig(pool=run.pool, variant=run.variant, seed=run.seed, max_attempts=run.attempts)
        args = replace(args, out=str(tmp_path / run.name))
        finish_run(args, 1)
    found = Checkpoints(tmp_path)
    for attempts in TABLE_ATTEMPTS:
        trial = Trial(method="policy", pool="dining", attempts=attempts)
        extra = "" if attempts == 5 else f"-attempts{attempts}"
        assert found.find(trial) == tmp_path / f"dining-policy{extra}-0" / "policy"
        # Other seeds are trained with the usual number alone, and act with whatever number is asked for.
        assert found.find(replace(trial, training_seed=2)) == tmp_path / "dining-policy-2" / "policy"


@pytest.mark.parametrize(
    "wrong",
    [
        ["--suite-list"],
        ["--pools", "dining"],
        ["--suite", "paper", "--seed", "1", "--variant", "beta"],
        ["--suite", "extended", "--support", "bar_table"],
        ["--suite", "paper", "--change", "all"],
        ["--change", "tilt"],
        ["--suite", "all"],
        ["--memory-limit", "nan"],
        ["--memory-limit", "inf"],
        ["--memory-limit", "0"],
        ["--seed", "-1"],
        ["--seed", "4294967296"],
        ["--suite", "paper", "--seeds", "0", "-1"],
        ["--eval-action", "best"],
        ["--eval-every", "-1"],
        ["--suite", "paper", "--pools", "nowhere"],
        ["--suite", "paper", "--coordinator", "127.0.0.1:1"],
    ],
)
def test_what_cannot_be_meant_is_refused(wrong, tmp_path, capsys):
    assert main(["train", "--out", str(tmp_path / "run"), *wrong]) == 2
    assert capsys.readouterr().err.lstrip(" ╭─").startswith(("error: ", "Invalid choice"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("attempts", [1, 10])
@pytest.mark.parametrize("variant", VARIANTS)
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
