"""The suite: which runs, in which order, what is skipped, taken up, and what Ctrl-C leaves."""

import shutil
import signal
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from cluttergen_jax import train_suite
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.cli.main import main
from cluttergen_jax.config import VARIANTS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.resolved import Checkpoints
from cluttergen_jax.evaluation.suites import Scale, find_suite
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.policies.embedded import FOR_ANY_POOL
from cluttergen_jax.learning.ppo.checkpoint import read_record, save_policy, save_state
from cluttergen_jax.learning.training import suite_run
from cluttergen_jax.learning.training.pretrain import Pretraining
from cluttergen_jax.learning.training.run import Run, RunConfig
from cluttergen_jax.learning.training.suite import (
    DEFAULT_ATTEMPTS,
    POOLS,
    TABLE_ATTEMPTS,
    PlannedRun,
    plan,
)
from cluttergen_jax.learning.training.suite_run import config_of
from cluttergen_jax.learning.training.train import TrainConfig, recipe_of
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


def test_extended_tables_are_covered_with_one_seed():
    runs = plan("extended")
    names = [run.name for run in runs]
    assert len(set(names)) == len(names)
    assert {run.seed for run in runs} == {0}
    asked = {
        PlannedRun(trial.pool, trial.method, trial.training_seed, trial.attempts).name
        for study in find_suite("extended", Scale())
        for trial in study.trials
        if trial.method in POLICIES
    }
    assert {"dining-beta_free-0"} <= asked == set(names)
    commands = [config_of(TrainConfig(), run, Path("runs")) for run in runs]
    assert {(args.pool, args.num_objects) for args in commands} == {("dining", 10)}


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


def contents(folder):
    """Every file below a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_list_says_how_far_each_run_is(tmp_path, capsys):
    command = ["train", "--suite", "paper", "--pools", "dining", "--seeds", "0", "--out", str(tmp_path)]
    planned = plan("paper", ("dining",), (0,))
    names = [run.name for run in planned]
    for run, updates in zip([run for run in planned if run.variant == "policy"], (None, 1), strict=False):
        config = config_of(TrainConfig(), run, tmp_path)
        finish_run(config, updates or config.settings().ppo.num_updates, updates is None)
    before = contents(tmp_path)
    assert main([*command, "--suite-list"]) == 0
    listed = capsys.readouterr().out
    assert "1 done" in listed
    assert "the paper: 2,500,000" in listed
    assert "1000 attempts per second, measured" in listed
    words = {line.split()[0]: line.split()[1] for line in listed.splitlines() if line.startswith("  dining")}
    assert list(words) == names
    begun = {"dining-policy-0": "done", "dining-policy-attempts1-0": "begun"}
    assert words == dict.fromkeys(names, "to") | begun
    assert "100,352 and 2,502,400 attempts" in listed
    assert contents(tmp_path) == before


def test_what_is_done_is_left_alone_and_other_settings_are_refused(tmp_path, capsys):
    command = ["train", "--suite", "paper", "--suite-only", "dining-policy-0", "--out", str(tmp_path)]
    (run,) = plan("paper", only="dining-policy-0")
    config = config_of(TrainConfig(), run, tmp_path)
    finish_run(config, config.settings().ppo.num_updates)
    before = contents(tmp_path)
    assert main(command) == 0
    assert main([*command, "--num-attempts", "9999"]) == 2
    assert "another ppo" in capsys.readouterr().err
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_the_papers_runs_begin_with_an_encoder_of_their_own(tmp_path, monkeypatch):
    """Pretrained once for all of them, unless another is given or it is to be trained along."""
    made = []

    def run(self):
        made.append((self.config.network.scene_encoder, self.config.network.object_features, self.folder))
        record = {"encoder": "pointnet", "features": 256, "held_out_accuracy": 0.9}
        save_policy(self.folder, {"x": np.ones(2)}, record)

    monkeypatch.setattr(Pretraining, "run", run)
    monkeypatch.setattr(suite_run, "run_training", lambda config, show: trained.append(config))
    for kind in (
        {},
        {"encoder_weights": str(tmp_path / "runs" / "encoder-pointnet")},
        {"encoder": "pointnet"},
    ):
        trained = []
        train_suite("paper", suite_only="dining-*-0", out=tmp_path / "runs", show=lambda text: None, **kind)
        given = {Path(config.out).name: (config.preset, config.encoder_weights) for config in trained}
        weights = None if "encoder" in kind else str(tmp_path / "runs" / "encoder-pointnet")
        assert given["dining-beta_free-0"] == given["dining-open_loop-0"] == ("paper_cpu", weights)
        assert given["dining-policy-0"] == ("cpu", None)
    assert made == [("pointnet", 256, tmp_path / "runs" / "encoder-pointnet")]


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


def test_evaluation_finds_the_runs_by_their_names(tmp_path):
    for run in plan("paper", ("dining",), (0, 2)):
        args = TrainConfig(pool=run.pool, variant=run.variant, seed=run.seed, max_attempts=run.attempts)
        args = replace(args, out=str(tmp_path / run.name))
        finish_run(args, 1)
    found = Checkpoints(tmp_path)
    for attempts in TABLE_ATTEMPTS:
        trial = Trial(method="policy", pool="dining", attempts=attempts)
        extra = "" if attempts == 5 else f"-attempts{attempts}"
        assert found.find(trial).path == tmp_path / f"dining-policy{extra}-0" / "policy"
        # Other seeds are trained with the usual number alone, and act with whatever number is asked for.
        assert found.find(replace(trial, training_seed=2)).path == tmp_path / "dining-policy-2" / "policy"


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
