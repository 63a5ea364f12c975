"""Training of one placement policy, from scratch or from where it stopped."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from cluttergen_jax.assets.pool import composed, find_pool, public_name
from cluttergen_jax.config import EvalAction
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo.checkpoint import check_folder
from cluttergen_jax.placement.config import placement_record

if TYPE_CHECKING:
    from cluttergen_jax.learning.training.presets import Settings

ACTIONS = get_args(EvalAction)


@dataclass(frozen=True)
class TrainConfig:
    """What one run is given; the fields are arguments of `train`.

    Raises:
      ConfigError: one of them is out of range.
    """

    pool: str = "dining"
    support: str = "table"
    change: str = "none"
    num_objects: int = 10
    max_attempts: int = 5
    preset: str = "cpu"
    variant: str = "policy"
    num_attempts: int | None = None
    num_envs: int | None = None
    seed: int = 0
    reward: str | None = None
    encoder: str | None = None
    encoder_weights: str | None = None
    encoder_frozen: bool = False
    out: str | None = None
    engine: str = "auto"
    eval_every: int = 0
    eval_episodes: int = 256
    eval_action: str | None = None
    memory_limit: float | None = None
    wandb: bool = False

    def __post_init__(self) -> None:
        if self.eval_action not in (None, *ACTIONS):
            raise ConfigError(f"eval_action = {self.eval_action!r}", ", ".join(ACTIONS))
        for name in ("eval_every", "eval_episodes"):
            if getattr(self, name) < 0:
                raise ConfigError(f"{name} = {getattr(self, name)}", "0 or more")
        if not 0 <= self.seed < 2**32:
            raise ConfigError(f"seed = {self.seed}", "0 to 4294967295")
        if self.memory_limit is not None and not 0 < self.memory_limit < math.inf:
            raise ConfigError(f"memory_limit = {self.memory_limit}", "finite GB above zero, such as 8")

    @property
    def folder(self) -> Path:
        """The run's."""
        return Path(self.out or f"runs/{public_name(self.pool)}-{self.variant}-{self.seed}")

    def settings(self) -> Settings:
        """The preset with what is changed of it."""
        from cluttergen_jax.learning.training.presets import choose_encoder, make_settings

        settings = make_settings(self.preset, self.variant)
        placement = dataclasses.replace(
            settings.placement, num_objects=self.num_objects, max_attempts=self.max_attempts
        )
        if self.reward is not None:
            placement = dataclasses.replace(placement, reward=self.reward)
        network = choose_encoder(settings.network, self.encoder, self.encoder_weights, self.encoder_frozen)
        network = network.with_attempts(self.max_attempts)
        changes = {"num_attempts": self.num_attempts, "num_envs": self.num_envs}
        given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
        ppo = dataclasses.replace(settings.ppo, **given)
        return dataclasses.replace(settings, placement=placement, network=network, ppo=ppo)


def train(
    pool: str | Path = "dining",
    support: str | Path = "table",
    num_objects: int = 10,
    *,
    exclude: Sequence[str] = (),
    change: str = "none",
    max_attempts: int = 5,
    preset: str = "cpu",
    variant: str = "policy",
    num_attempts: int | None = None,
    num_envs: int | None = None,
    seed: int = 0,
    reward: str | None = None,
    encoder: str | None = None,
    encoder_weights: str | Path | None = None,
    encoder_frozen: bool = False,
    out: str | Path | None = None,
    engine: str = "auto",
    eval_every: int = 0,
    eval_episodes: int = 256,
    eval_action: str | None = None,
    memory_limit: float | None = None,
    wandb: bool = False,
    coordinator: str | None = None,
    num_processes: int | None = None,
    process_id: int | None = None,
    show: Callable[[str], None] = print,
) -> Path:
    """Trains a placement policy with PPO (`cluttergen train`). The same call takes up an interrupted run.

    Args:
      pool, support, exclude, engine: as in `make_sampler`.
      num_objects: objects per scene.
      change: how the queried region is changed at random in every episode: "none", "translation",
        "rotation", "shrinkage", "expansion" or "all".
      max_attempts: per object, 1 to 10.
      preset: "cpu", "tight" (for crowded tables), "gpu" or "paper".
      variant: "policy" (the full method), "open_loop", "short_memory", "normal", "beta" or "ranked".
      num_attempts, num_envs, reward, encoder: environment steps of the run, environments side by side, the
        reward ("paper", "code", "compressed") and the scene's encoder ("set", "pointnet", "pointnet2"); the
        preset's if not given.
      seed: of weights, episodes and actions, 0 to 4294967295.
      encoder_weights: the folder of pretrained weights that the encoder begins with (`pretrain`).
      encoder_frozen: leave these weights as they are.
      out: the run's folder, runs/POOL-VARIANT-SEED if not given.
      eval_every: attempts between evaluations; 0 evaluates at the end only.
      eval_episodes: fresh episodes of each evaluation; 0 leaves evaluations out.
      eval_action: "sampled", or "mean" (of a ranker's candidates, the best); as `generate` acts if not given.
      memory_limit: GB that the run may need; what is free if not given.
      wandb: send the figures to Weights & Biases too (extra `wandb`).
      coordinator, num_processes, process_id: HOST:PORT of the first of several processes that train one
        policy together, how many there are, and which of them this is, from 0; the first one writes.
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
    fields = {field.name: given[field.name] for field in dataclasses.fields(TrainConfig)}
    paths = {name: fields[name] and str(fields[name]) for name in ("support", "encoder_weights", "out")}
    config = TrainConfig(**fields | paths | {"pool": composed(pool, exclude)})
    from cluttergen_jax.learning.training.distributed import join

    join(coordinator, num_processes, process_id)
    return run_training(config, show=show)


def run_training(
    config: TrainConfig, settings: Settings | None = None, show: Callable[[str], None] = print
) -> Path:
    """One run to its end; the policy's folder. See `train`.

    Args:
      settings: in place of `config.settings()`, for an experiment that changes more than an argument does.
    """
    # Brax takes seconds to import, and only who trains needs it.
    from cluttergen_jax.learning.training.distributed import is_writer
    from cluttergen_jax.learning.training.evaluator import Evaluator
    from cluttergen_jax.learning.training.run import Run, RunConfig
    from cluttergen_jax.placement.problem import ProblemConfig, make_problem

    settings = settings or config.settings()
    problem = make_problem(
        ProblemConfig(
            pool=config.pool,
            support=config.support,
            change=config.change,
            engine=config.engine,
            placement=settings.placement,
            stability=settings.stability,
        )
    )
    recipe = recipe_of(config, settings)
    check_folder(config.folder, recipe)
    say = show if is_writer() else _say_nothing
    say(f"run        {config.folder}")
    own = settings.network.is_sampled
    is_sampled = own if config.eval_action is None else config.eval_action == "sampled"
    evaluate = Evaluator(problem, settings.network, config.eval_episodes, is_sampled, config.seed)
    Run(
        problem.rules,
        settings.network,
        settings.ppo,
        RunConfig(
            seed=config.seed,
            eval_every=config.eval_every,
            memory_limit=None if config.memory_limit is None else int(config.memory_limit * 1e9),
            wandb=config.wandb,
        ),
        config.folder,
        recipe,
        evaluate if config.eval_episodes else None,
        None if config.encoder_weights is None else Path(config.encoder_weights),
    ).train(show)
    say(f"done       policy in {config.folder / 'policy'}, curve in {config.folder / 'curve.png'}")
    return config.folder / "policy"


def recipe_of(config: TrainConfig, settings: Settings) -> dict[str, Any]:
    """What a checkpoint says of how it was made."""
    # Runs that were begun before regions could change are still runs of the same settings.
    changed = {} if config.change == "none" else {"change": config.change}
    return changed | {
        "pool": config.pool,
        "pool_hash": find_pool(config.pool).hash,
        "support": config.support,
        "variant": config.variant,
        "encoder_weights": config.encoder_weights,
        "preset": config.preset,
        "seed": config.seed,
        **dataclasses.asdict(settings),
        "placement": placement_record(settings.placement),
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax", "flax")},
    }


def _say_nothing(text: str) -> None:
    del text
