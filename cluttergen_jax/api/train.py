"""Training of placement policies: one run, or all runs of a suite."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cluttergen_jax.config import Change, Encoder, Engine, EvalAction, Preset, Reward, Suite, Variant
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.training.suite import POOLS, SEEDS
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    from cluttergen_jax.learning.training.suite_run import SuiteReport


@with_own_settings
def train(
    pool: str | Path = "dining",
    support: str | Path = "table",
    num_objects: int = 10,
    *,
    exclude: Sequence[str] = (),
    change: Change = "none",
    max_attempts: int = 5,
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
    engine: Engine = "auto",
    eval_every: int = 0,
    eval_episodes: int = 256,
    eval_action: EvalAction | None = None,
    memory_limit: float | None = None,
    wandb: bool = False,
    coordinator: str | None = None,
    num_processes: int | None = None,
    process_id: int | None = None,
    show: Callable[[str], None] = print,
) -> Path:
    """Trains a placement policy with PPO (`cluttergen train`). The same call takes up an interrupted run.

    Args:
      pool: a pool's name or folder, or several joined by +: dining+mine.
      support: a support's name or folder; "table-0.40x0.50" is a cuboid of that size.
      num_objects: objects per scene.
      exclude: names of the pool's objects to leave out; exclude=("mug",) is the same as pool="dining~mug".
      change: how the queried region is changed at random in every episode: "none", "translation",
        "rotation", "shrinkage", "expansion" or "all".
      max_attempts: per object, 1 to 10.
      paper: train as in the paper: variant "beta_free", preset "paper" with an accelerator and "paper_cpu"
        without, unless one of its presets or another variant is given; the encoder is pretrained first, in
        a folder beside the run's, where there is none. The whole run is 2,500,000 attempts: hours on two
        cores.
      preset: "cpu", "gpu", "paper" (as printed), "paper_code" (as its published code has it) or "paper_cpu"
        (as printed, with smaller clouds); the paper's three want `encoder_weights`, or `encoder` for one that
        is trained along.
      variant: "guided" (no policy: one network for every pool, which takes `num_attempts`, `seed` and `out`
        alone), "policy" (the full method), "open_loop", "short_memory", "normal", "beta" or "beta_free".
      num_attempts: environment steps of the run; the preset's if not given.
      num_envs: environments side by side; the preset's if not given.
      seed: of weights, episodes and actions, 0 to 4294967295.
      reward: "paper", "code" or "compressed"; the preset's if not given.
      encoder: of the scene: "set", "pointnet" or "pointnet2"; the preset's if not given.
      encoder_weights: folder of pretrained weights that the point encoders begin with (`pretrain`).
      encoder_frozen: leave these weights as they are, as the paper's presets do unasked.
      out: the run's folder, runs/POOL-VARIANT-SEED (runs/guided-SEED) if not given; of a suite, the folder
        of all its runs.
      engine: "auto", "native", "warp" or "jax".
      eval_every: attempts between evaluations; 0 evaluates at the end only.
      eval_episodes: fresh episodes of each evaluation; 0 leaves evaluations out.
      eval_action: "sampled", as `generate` acts and if not given, or "mean".
      memory_limit: GB that the run may need; what is free if not given.
      wandb: send the figures to Weights & Biases too (extra wandb).
      coordinator: HOST:PORT of the first of several processes that train one policy together.
      num_processes: how many there are.
      process_id: which of them this is, from 0; the first one writes.
      show: is given the lines that tell how far the run is.

    Returns:
      The policy's folder: `checkpoint` of `make_sampler` and `generate`.

    Raises:
      ConfigError: a setting is out of range, or the folder holds a run with other settings.
      PoolError: the pool or the support cannot be found or read.
      DivergedError: numbers are not finite any more; the last good state is saved.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    given = dict(locals())
    from cluttergen_jax.assets.pool import composed
    from cluttergen_jax.learning.training.distributed import join
    from cluttergen_jax.learning.training.train import as_in_paper, run_training, train_config

    if variant == "guided":
        from cluttergen_jax.learning.training.guided import train_guided

        _refuse(given, _TAKEN_BY_GUIDED)
        return train_guided(num_attempts, seed, out, show)
    config = train_config(given | {"pool": composed(pool, exclude)})
    join(coordinator, num_processes, process_id)
    if paper:
        config = as_in_paper(config, show)
    return run_training(config, show=show)


_TAKEN_BY_GUIDED = ("variant", "seed", "num_attempts", "out", "show")


def _refuse(given: Mapping[str, Any], taken: Sequence[str]) -> None:
    """Refuses arguments of `train` that a variant does not take and that are not at their defaults."""
    kinds = inspect.signature(train).parameters
    for name, value in given.items():
        if name not in taken and value != kinds[name].default:
            raise ConfigError(
                f"{name} = {value!r} with variant {given['variant']!r}",
                "seed, num_attempts and out: one network learns from shapes of the modeller, for every pool",
                f"leaving {name} out",
            )


@with_own_settings
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
      suite: "paper" or "extended": all policies that the tables of `cluttergen evaluate --suite` need. Runs
        that are done are left alone, others are taken up.
      suite_list: only list the suite's runs, with the time that they will take.
      suite_only: only the runs whose names match, such as 'dining-*' or '*-policy-0'.
      pools: of the suite.
      seeds: of the suite.

    Raises:
      ConfigError: there is no such suite, nothing is left of it, or a folder holds a run of other settings.
      PoolError: one of the pools cannot be found.
    """
    given = dict(locals())
    from cluttergen_jax.learning.training.suite_run import run_suite
    from cluttergen_jax.learning.training.train import train_config

    root = Path(out or "runs")
    base = train_config(given | {"out": root})
    return run_suite(suite, base, root, pools, seeds, suite_only, suite_list, show)
