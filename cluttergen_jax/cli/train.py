"""`cluttergen train`: the policy, from scratch or from where it stopped; or all policies of a suite."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.parse import keywords, refuse_given
from cluttergen_jax.config import Change, Encoder, Engine, EvalAction, Preset, Reward, Suite, Variant
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.training.suite import POOLS, SEEDS

_OF_SUITES = ("suite_list", "suite_only", "pools", "seeds")
_OF_RUNS = ("pool", "exclude", "support", "change", "num_objects", "variant", "attempts", "seed")
_OF_PROCESSES = ("coordinator", "num_processes", "process_id")


@dataclass(frozen=True)
class Train:
    """Train a placement policy with PPO. The same command takes an interrupted run up again.

    Example: `cluttergen train --pool dining --preset cpu`

    Attributes:
      pool: a pool's name or folder, or several joined by +: dining+mine.
      exclude: names of the pool's objects to leave out; --exclude mug is the same as --pool dining~mug.
      support: a support's name or folder; table-0.40x0.50 is a cuboid of that size.
      change: how the queried region is changed at random in every episode: none, translation, rotation,
        shrinkage, expansion or all.
      num_objects: objects per scene.
      attempts: per object, 1 to 10.
      preset: cpu, tight (for crowded tables), gpu or paper.
      variant: policy (the full method), open_loop, short_memory, normal, beta or ranked.
      num_attempts: environment steps of the run; the preset's if not given.
      num_envs: environments side by side; the preset's if not given.
      seed: of weights, episodes and actions.
      reward: paper, code or compressed; the preset's if not given.
      encoder: of the scene: set, pointnet or pointnet2; the preset's if not given.
      encoder_weights: folder of pretrained weights that the point encoders begin with (cluttergen pretrain).
      encoder_frozen: leave these weights as they are.
      out: the run's folder, runs/POOL-VARIANT-SEED if not given; of a suite, the folder of all its runs.
      engine: auto, native, warp or jax.
      eval_every: attempts between evaluations; 0 evaluates at the end only.
      eval_episodes: fresh episodes of each evaluation; 0 leaves evaluations out.
      eval_action: sampled, or mean (of a ranker's candidates, the best); as `generate` acts if not given.
      memory_limit: GB that the run may need; what is free if not given.
      wandb: send the figures to Weights & Biases too (extra wandb).
      suite: paper or extended: all policies that the tables of `evaluate --suite` need. Runs that are done
        are left alone, others are taken up.
      suite_list: only list the suite's runs, with the time that they will take.
      suite_only: only the runs whose names match, such as 'dining-*' or '*-policy-0'.
      pools: of the suite.
      seeds: of the suite.
      coordinator: HOST:PORT of the first of several processes that train one policy together.
      num_processes: how many there are.
      process_id: which of them this is, from 0; the first one writes.
    """

    pool: str = "dining"
    exclude: tuple[str, ...] = ()
    support: str = "table"
    change: Change = "none"
    num_objects: int = 10
    attempts: int = 5
    preset: Preset = "cpu"
    variant: Variant = "policy"
    num_attempts: int | None = None
    num_envs: int | None = None
    seed: int = 0
    reward: Reward | None = None
    encoder: Encoder | None = None
    encoder_weights: str | None = None
    encoder_frozen: bool = False
    out: str | None = None
    engine: Engine = "auto"
    eval_every: int = 0
    eval_episodes: int = 256
    eval_action: EvalAction | None = None
    memory_limit: float | None = None
    wandb: bool = False
    suite: Suite | None = None
    suite_list: bool = False
    suite_only: str | None = None
    pools: tuple[str, ...] = POOLS
    seeds: tuple[int, ...] = SEEDS
    coordinator: str | None = None
    num_processes: int | None = None
    process_id: int | None = None

    def run(self) -> int:
        """Runs the command; the exit status."""
        if self.suite is None:
            refuse_given(self, _OF_SUITES, "without a suite", "--suite paper")
            from cluttergen_jax.learning.training.train import train

            train(**keywords(self, without=("suite", *_OF_SUITES)))
            return 0
        refuse_given(self, _OF_RUNS, "with a suite", "leaving it out: each run has its own")
        if self.coordinator is not None:
            raise ConfigError("a suite on several processes", "one run at a time there", "--suite-list")
        from cluttergen_jax.learning.training.suite_run import train_suite

        report = train_suite(**keywords(self, without=(*_OF_RUNS, *_OF_PROCESSES)))
        for name, error in report.failed.items():
            print(f"error: {name}: {with_flags(error, Train)}", file=sys.stderr)
        if report.failed:
            print(f"failed: {', '.join(report.failed)}; the same command tries them again", file=sys.stderr)
        return 1 if report.failed else 0
