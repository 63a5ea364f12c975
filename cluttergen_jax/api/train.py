"""Training: of placement policies, one run or all runs of a suite, and of point encoders before them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.config import (
    Change,
    Encoder,
    Engine,
    EvalAction,
    Preset,
    Reward,
    Suite,
    Variant,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.training.suite import POOLS, SEEDS
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.placement.methods.table import TARGETS
from cluttergen_jax.spec import SceneOptions, SceneSpec, in_groups, spec_of, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.learning.training.pretrain import PretrainReport
    from cluttergen_jax.learning.training.suite_run import SuiteReport
    from cluttergen_jax.learning.training.train import TrainConfig

_NOT_TAKEN = {
    **dict.fromkeys(("sets", "shelf", "weights", "balance"), "where a policy learns in one world"),
    **dict.fromkeys(("keep_out", "start"), "where every episode begins on an empty support"),
    "setting": "where rules that are not given are those of the preset",
    **dict.fromkeys(("height", *TARGETS, "clearance", "crowd"), "of methods that are not trained"),
    "doors": "where they stay as they stand",
    "poses": "of which a policy, which sees clouds of upright objects, would know nothing",
    **dict.fromkeys(("method", "checkpoint"), "where `variant` says what is trained"),
}
"""Fields of a `SceneSpec` that training does not take, and why."""


@with_kept_programs
@takes_spec(_NOT_TAKEN, num_objects=10)
@in_groups(
    where="change",
    how_many="num_attempts num_envs seed eval_every eval_episodes",
    files="out wandb",
    machine="memory_limit coordinator num_processes process_id",
)
def train(
    spec: SceneSpec | str | Path | None = None,
    *,
    change: Change = "none",
    paper: bool = False,
    preset: Preset = "cpu",
    variant: Variant = "policy",
    num_attempts: int | None = None,
    num_envs: int | None = None,
    seed: int = 0,
    reward: Reward | None = None,
    encoder: Encoder | None = None,
    encoder_weights: str | Path | None = None,
    encoder_frozen: bool = False,
    out: str | Path | None = None,
    eval_every: int = 0,
    eval_episodes: int = 256,
    eval_action: EvalAction | None = None,
    memory_limit: float | None = None,
    wandb: bool = False,
    coordinator: str | None = None,
    num_processes: int | None = None,
    process_id: int | None = None,
    show: Callable[[str], None] = print,
    **options: Unpack[SceneOptions],
) -> Path:
    """Trains a placement policy with PPO (`cluttergen train`). The same call takes up an interrupted run.

    The arguments that are not explained here are those of `SceneSpec`.

    Args:
      spec: what is asked for, or a pool's name.
      change: how the queried region is changed at random in every episode: "none", "translation",
        "rotation", "shrinkage", "expansion" or "all".
      paper: train as in the paper: variant "beta_free", preset "paper" with an accelerator and "paper_cpu"
        without, unless one of its presets or another variant is given; the encoder is pretrained first, in
        a folder beside the run's, where there is none. The whole run is 2,500,000 attempts: hours on two
        cores.
      preset: "cpu", "gpu", "paper" (as printed), "paper_code" (as its published code has it) or "paper_cpu"
        (as printed, with smaller clouds); the paper's three want `encoder_weights`, or `encoder` for one that
        is trained along.
      variant: "guided" (no policy: one network for every pool, which takes `num_attempts`, `seed` and `out`
        alone), "policy" (the full method), "open_loop", "short_memory", "normal" or "beta_free".
      num_attempts: environment steps of the run; the preset's if not given.
      num_envs: environments side by side; the preset's if not given.
      seed: of weights, episodes and actions, 0 to 4294967295.
      reward: "paper", "code" or "compressed"; the preset's if not given.
      encoder: of the scene: "set", "pointnet" or "pointnet2"; the preset's if not given.
      encoder_weights: folder of pretrained weights that the point encoders begin with (`training.pretrain`).
      encoder_frozen: leave these weights as they are, as the paper's presets do unasked.
      out: the run's folder, runs/POOL-VARIANT-SEED (runs/guided-SEED) if not given; of a suite, the folder
        of all its runs.
      eval_every: attempts between evaluations; 0 evaluates at the end only.
      eval_episodes: fresh episodes of each evaluation; 0 leaves evaluations out.
      eval_action: "sampled", as `generate` acts and if not given, or "mean".
      memory_limit: GB that the run may need; what is free if not given.
      wandb: send the figures to Weights & Biases too (extra wandb).
      coordinator: HOST:PORT of the first of several processes that train one policy together.
      num_processes: how many there are.
      process_id: which of them this is, from 0; the first one writes.
      show: is given the lines that tell how far the run is.
      options: fields of `SceneSpec`, in place of those of `spec`: those that say in which world to train.

    Returns:
      The policy's folder: `checkpoint` of `make_sampler` and `generate`.

    Raises:
      ConfigError: a setting is out of range, or the folder holds a run with other settings.
      PoolError: the pool or the support cannot be found or read.
      BankError: another process writes to `out`.
      DivergedError: numbers are not finite any more; the last good state is saved.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    from cluttergen_jax.learning.ppo.sharding import join
    from cluttergen_jax.learning.training.train import TrainConfig, as_in_paper, run_training

    asked = spec_of(train, spec, options)
    asked.check_sense()
    if asked.num_objects is None:
        asked = replace(asked, num_objects=10)
    config = TrainConfig(
        preset=preset,
        variant=variant,
        num_attempts=num_attempts,
        num_envs=num_envs,
        seed=seed,
        reward=reward,
        encoder=encoder,
        encoder_weights=None if encoder_weights is None else str(encoder_weights),
        encoder_frozen=encoder_frozen,
        out=None if out is None else str(out),
        eval_every=eval_every,
        eval_episodes=eval_episodes,
        eval_action=eval_action,
        memory_limit=memory_limit,
        wandb=wandb,
    )
    if variant == "guided":
        from cluttergen_jax.learning.training.guided import train_guided

        given: dict[str, object] = {
            name: value for name, value in asked.overrides().items() if name != "num_objects"
        }
        given["change"] = None if change == "none" else change
        given["num_objects"] = None if asked.num_objects == 10 else asked.num_objects
        given["paper"] = paper or None
        _check_guided(config, given | {"coordinator": coordinator})
        return train_guided(num_attempts, seed, out, show)
    # Which engine there is can be asked once all processes have met.
    join(coordinator, num_processes, process_id)
    # Rules that are not given are the preset's.
    problem = replace(asked, setting="paper").problem_config(None, asked.find_pool())
    # Doors stay as they stand.
    problem = replace(problem, placement=replace(problem.placement, doors=None))
    # All objects of the pool are in one world.
    config = replace(config, problem=replace(problem, change=change, shelf=0))
    if paper:
        config = as_in_paper(config, show)
    return run_training(config, show=show)


# The problem is what the request's own fields ask for.
_OF_GUIDED = ("variant", "seed", "num_attempts", "out", "problem")


def _check_guided(config: TrainConfig, more: Mapping[str, object]) -> None:
    """Refuses what "guided" does not take: fields not at their defaults, and what of `more` is not None."""
    values = {
        each.name: getattr(config, each.name)
        for each in fields(config)
        if each.name not in _OF_GUIDED
    }
    usual = {each.name: each.default for each in fields(config)}
    given = [
        f"{name} = {value!r}"
        for name, value in {**values, **more}.items()
        if value != usual.get(name)
    ]
    if given:
        raise ConfigError(
            f"{given[0]} with variant 'guided'",
            "seed, num_attempts and out: one network learns from shapes of the modeller, for every pool",
            "leaving it out",
        )


@with_kept_programs
@in_groups(
    what="suite suite_list suite_only pools",
    how_many="seeds num_attempts num_envs eval_every eval_episodes",
    files="out wandb",
    machine="engine memory_limit",
)
def train_suite(
    suite: Suite,
    *,
    suite_list: bool = False,
    suite_only: str | None = None,
    pools: Sequence[str] = POOLS,
    seeds: Sequence[int] = SEEDS,
    preset: Preset = "cpu",
    num_attempts: int | None = None,
    num_envs: int | None = None,
    reward: Reward | None = None,
    encoder: Encoder | None = None,
    encoder_weights: str | Path | None = None,
    encoder_frozen: bool = False,
    out: str | Path | None = None,
    engine: Engine = "auto",
    eval_every: int = 0,
    eval_episodes: int = 256,
    eval_action: EvalAction | None = None,
    memory_limit: float | None = None,
    wandb: bool = False,
    show: Callable[[str], None] = print,
) -> SuiteReport:
    """Trains all policies that the tables of `evaluate` need; `cluttergen train --suite`.

    Runs that are done are left alone, others are taken up. Ctrl-C stops the whole suite; a run that fails
    stops no other. The arguments that are not explained here are those of `train`.

    Args:
      suite: "paper" or "extended": all policies that the tables of `python evaluate.py --suite` need. Runs
        that are done are left alone, others are taken up.
      suite_list: only list the suite's runs, with the time that they will take.
      suite_only: only the runs whose names match, such as 'dining-*' or '*-policy-0'.
      pools: of the suite.
      seeds: of the suite.

    Raises:
      ConfigError: there is no such suite, nothing is left of it, or a folder holds a run of other settings.
      PoolError: one of the pools cannot be found.
    """
    from cluttergen_jax.learning.training.suite_run import run_suite
    from cluttergen_jax.learning.training.train import TrainConfig
    from cluttergen_jax.placement.problem import ProblemConfig

    root = Path(out or "runs")
    base = TrainConfig(
        problem=ProblemConfig(engine=engine),
        preset=preset,
        num_attempts=num_attempts,
        num_envs=num_envs,
        reward=reward,
        encoder=encoder,
        encoder_weights=None if encoder_weights is None else str(encoder_weights),
        encoder_frozen=encoder_frozen,
        out=str(root),
        eval_every=eval_every,
        eval_episodes=eval_episodes,
        eval_action=eval_action,
        memory_limit=memory_limit,
        wandb=wandb,
    )
    return run_suite(suite, base, root, pools, seeds, suite_only, suite_list, show)


@with_kept_programs
def pretrain(
    encoder: Encoder = "pointnet2",
    out: str | Path | None = None,
    *,
    features: int | None = None,
    object_points: int = 512,
    num_centroids: int = 128,
    group_size: int = 16,
    num_shapes: int = 16,
    num_held_out: int = 4,
    num_epochs: int = 20,
    batch_size: int = 32,
    learning_rate: float = 1e-3,
    seed: int = 0,
) -> PretrainReport:
    """Pretrains a point encoder by classifying shapes (`cluttergen pretrain`).

    The classes are the families of the modeller (those of the five pools), each with many objects of drawn
    proportions. The same call resumes an interrupted run.

    Args:
      encoder: "pointnet2" (the paper's), "pointnet", or "set" (the small one of the set encoder).
      out: the run's folder; runs/encoder-ENCODER if not given.
      features: of the encoder; 64 for "set" and 1,024 for the others if not given.
      object_points: of each cloud; at most 1,024 are used in training.
      num_centroids: of the first level of PointNet++.
      group_size: points around each of them.
      num_shapes: objects of each family to learn from.
      num_held_out: objects of each family to test with.
      num_epochs: times that all of the former are seen.
      batch_size: shapes per step.
      learning_rate: of Adam, at first.
      seed: of shapes, weights and their order.

    Returns:
      The folder, which `encoder_weights` of `train` takes, and the accuracy on what was held out.

    Raises:
      ConfigError: a setting is out of range, or the folder holds a run with other settings.
      BankError: another process writes to `out`.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    from cluttergen_jax.learning.training.pretrain import (
        PretrainConfig,
        Pretraining,
        PretrainReport,
        small,
    )
    from cluttergen_jax.learning.training.run_folder import hold_run

    sizes = small(encoder)
    if features is not None:
        sizes = replace(sizes, object_features=features, scene_features=features)
    config = PretrainConfig(
        replace(
            sizes, object_points=object_points, num_centroids=num_centroids, group_size=group_size
        ),
        num_shapes=num_shapes,
        num_held_out=num_held_out,
        num_epochs=num_epochs,
        batch_size=batch_size,
        learning_rate=learning_rate,
        seed=seed,
    )
    folder = Path(out or f"runs/encoder-{encoder}")
    with hold_run(folder):
        accuracy = Pretraining(config, folder).run()
    return PretrainReport(
        folder, accuracy, num_held_out * len(config.families), len(config.families)
    )
