"""`cluttergen train`: the policy, from scratch or from where it stopped; or all policies of a suite."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from cluttergen_jax.cli.parse import refuse_given
from cluttergen_jax.config import Change, Encoder, Engine, Preset, Reward, Suite, Variant
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.config import placement_record
from cluttergen_jax.training.suite import POOLS, SEEDS

if TYPE_CHECKING:
    from cluttergen_jax.training.presets import Settings

Action = Literal["sampled", "mean"]
ACTIONS = get_args(Action)
_OF_SUITES = ("suite_list", "suite_only", "pools", "seeds")
_OF_RUNS = ("pool", "exclude", "support", "change", "num_objects", "variant", "attempts", "seed")


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
      suite: paper or honest: all policies that the tables of `evaluate --suite` need. Runs that are done are
        left alone, others are taken up.
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
    eval_action: Action | None = None
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
        self._check()
        if self.suite is not None:
            # Brax takes seconds to import, and a suite that is only listed needs none of it.
            from cluttergen_jax.cli.training_suite import run_suite

            return run_suite(self)
        from cluttergen_jax.assets.pool import composed
        from cluttergen_jax.training.distributed import join

        join(self.coordinator, self.num_processes, self.process_id)
        dataclasses.replace(self, pool=composed(self.pool, self.exclude), exclude=()).train()
        return 0

    def train(self) -> None:
        """One run, to its end."""
        # Brax takes seconds to import, and only who trains needs it.
        from cluttergen_jax.agent.checkpoint import check_folder
        from cluttergen_jax.cli.training_evaluation import Evaluator
        from cluttergen_jax.problem import ProblemConfig, make_problem
        from cluttergen_jax.training.distributed import is_writer
        from cluttergen_jax.training.run import Run, RunConfig

        settings = self.settings()
        problem = make_problem(
            ProblemConfig(
                pool=self.pool,
                support=self.support,
                change=self.change,
                engine=self.engine,
                placement=settings.placement,
                stability=settings.stability,
            )
        )
        recipe = recipe_of(self, settings)
        check_folder(self.folder, recipe)
        say = print if is_writer() else _say_nothing
        say(f"run        {self.folder}")
        config = RunConfig(
            seed=self.seed,
            eval_every=self.eval_every,
            memory_limit=None if self.memory_limit is None else int(self.memory_limit * 1e9),
            wandb=self.wandb,
        )
        own = settings.network.is_sampled
        is_sampled = own if self.eval_action is None else self.eval_action == "sampled"
        evaluate = Evaluator(problem, settings.network, self.eval_episodes, is_sampled, self.seed)
        Run(
            problem.rules,
            settings.network,
            settings.ppo,
            config,
            self.folder,
            recipe,
            evaluate if self.eval_episodes else None,
            None if self.encoder_weights is None else Path(self.encoder_weights),
        ).train()
        say(f"done       policy in {self.folder / 'policy'}, curve in {self.folder / 'curve.png'}")

    @property
    def folder(self) -> Path:
        """The run's."""
        from cluttergen_jax.assets.pool import public_name

        return Path(self.out or f"runs/{public_name(self.pool)}-{self.variant}-{self.seed}")

    def settings(self) -> Settings:
        """The preset with what the command line changes."""
        from cluttergen_jax.training.encoder_weights import choose_encoder
        from cluttergen_jax.training.presets import make_settings

        settings = make_settings(self.preset, self.variant)
        placement = dataclasses.replace(
            settings.placement, num_objects=self.num_objects, max_attempts=self.attempts
        )
        if self.reward is not None:
            placement = dataclasses.replace(placement, reward=self.reward)
        network = choose_encoder(settings.network, self.encoder, self.encoder_weights, self.encoder_frozen)
        network = network.with_attempts(self.attempts)
        changes = {"num_attempts": self.num_attempts, "num_envs": self.num_envs}
        given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
        ppo = dataclasses.replace(settings.ppo, **given)
        return dataclasses.replace(settings, placement=placement, network=network, ppo=ppo)

    def _check(self) -> None:
        """Refuses what cannot be meant.

        Raises:
          ConfigError: it says which option.
        """
        if self.eval_action not in (None, *ACTIONS):
            raise ConfigError(f"--eval-action {self.eval_action}", ", ".join(ACTIONS))
        for name in ("eval_every", "eval_episodes"):
            if getattr(self, name) < 0:
                raise ConfigError(f"--{name.replace('_', '-')} {getattr(self, name)}", "0 or more")
        if not all(0 <= seed < 2**32 for seed in (self.seed, *self.seeds)):
            raise ConfigError(f"--seed {self.seed}, --seeds {self.seeds}", "0 to 4294967295 each")
        if self.memory_limit is not None and not 0 < self.memory_limit < math.inf:
            raise ConfigError(f"--memory-limit {self.memory_limit}", "finite GB above zero, such as 8")
        if self.suite is None:
            refuse_given(self, _OF_SUITES, "without a suite", "--suite paper")
        else:
            refuse_given(self, _OF_RUNS, "with a suite", "leaving it out: each run has its own")
        if self.suite is not None and self.coordinator is not None:
            raise ConfigError("a suite on several processes", "one run at a time there", "--suite-list")


def recipe_of(args: Train, settings: Settings) -> dict[str, Any]:
    """What a checkpoint says of how it was made."""
    from cluttergen_jax.assets.pool import find_pool

    # Runs that were begun before regions could change are still runs of the same settings.
    changed = {} if args.change == "none" else {"change": args.change}
    return changed | {
        "pool": args.pool,
        "pool_hash": find_pool(args.pool).hash,
        "support": args.support,
        "variant": args.variant,
        "encoder_weights": args.encoder_weights,
        "preset": args.preset,
        "seed": args.seed,
        **dataclasses.asdict(settings),
        "placement": placement_record(settings.placement),
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax", "flax")},
    }


def _say_nothing(text: str) -> None:
    del text
