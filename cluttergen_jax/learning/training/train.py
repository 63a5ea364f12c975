"""Training of one placement policy, from scratch or from where it stopped."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, get_args

from cluttergen_jax.assets import find_pool, public_name
from cluttergen_jax.config import EvalAction, Preset, StabilityConfig, stability_record
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError
from cluttergen_jax.learning.networks.config import KIND
from cluttergen_jax.learning.training.run_folder import Interrupt, RunFolder, hold_run, versions
from cluttergen_jax.physics import engine_of, step_seconds
from cluttergen_jax.placement.config import PlacementConfig, placement_record
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.progress import time_text
from cluttergen_jax.schema import Record

if TYPE_CHECKING:
    from cluttergen_jax.learning.training.presets import Settings

ACTIONS = get_args(EvalAction)


@dataclass(frozen=True)
class TrainConfig:
    """What one run is given; the fields are arguments of `cluttergen_jax.train`.

    Attributes:
      problem: what its `SceneSpec` asks for; where that is as usual, the preset decides.

    Raises:
      ConfigError: one of them is out of range.
    """

    problem: ProblemConfig = field(default_factory=ProblemConfig)
    preset: Preset = "cpu"
    variant: str = "policy"
    num_attempts: int | None = None
    num_envs: int | None = None
    seed: int = 0
    reward: str | None = None
    encoder: str | None = None
    encoder_weights: str | None = None
    encoder_frozen: bool = False
    out: str | None = None
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
            raise ConfigError(
                f"memory_limit = {self.memory_limit}", "finite GB above zero, such as 8"
            )

    @property
    def folder(self) -> Path:
        """The run's."""
        return Path(self.out or f"runs/{public_name(self.problem.pool)}-{self.variant}-{self.seed}")

    def settings(self) -> Settings:
        """The preset with what is changed of it."""
        from cluttergen_jax.learning.training.presets import choose_encoder, make_settings

        settings = make_settings(self.preset, self.variant)
        placement = _where_usual(self.problem.placement, settings.placement)
        if self.reward is not None:
            placement = dataclasses.replace(placement, reward=self.reward)
        network = choose_encoder(
            settings.network, self.encoder, self.encoder_weights, self.encoder_frozen
        )
        network = network.with_attempts(placement.max_attempts)
        ppo = dataclasses.replace(
            settings.ppo,
            num_attempts=settings.ppo.num_attempts
            if self.num_attempts is None
            else self.num_attempts,
            num_envs=settings.ppo.num_envs if self.num_envs is None else self.num_envs,
        )
        stability = _where_usual(self.problem.stability, settings.stability)
        return dataclasses.replace(
            settings, placement=placement, stability=stability, network=network, ppo=ppo
        )


_Config = TypeVar("_Config", PlacementConfig, StabilityConfig)


def _where_usual(asked: _Config, preset: _Config) -> _Config:
    """What is asked for, with the preset's values where nothing else than usual is."""
    usual = type(asked)()
    left_open = {
        name: getattr(preset, name)
        for name, value in vars(usual).items()
        if getattr(asked, name) == value
    }
    return dataclasses.replace(asked, **left_open)


_ASKED = ("change", "pool", "objects", "repeat", "support", "surface", "region", "polygon")
"""Fields of a problem that say in which world is trained."""
_PAPER_PRESETS = ("paper", "paper_code", "paper_cpu")


def as_in_paper(config: TrainConfig, show: Callable[[str], None] = print) -> TrainConfig:
    """The config with the paper's head, a preset by the machine, and an encoder, pretrained if there is none.

    A preset of the paper's and a variant that are given stay.

    Raises:
      ConfigError: another preset or variant was given.
    """
    import jax

    from cluttergen_jax.learning.training.presets import make_settings
    from cluttergen_jax.learning.training.pretrain import pretrain_for

    if config.preset not in ("cpu", *_PAPER_PRESETS):
        raise ConfigError(
            f"preset = {config.preset!r} with paper",
            ", ".join(_PAPER_PRESETS),
            "leaving preset out",
        )
    by_machine: Preset = "paper_cpu" if jax.default_backend() == "cpu" else "paper"
    preset = by_machine if config.preset == "cpu" else config.preset
    variant = "beta_free" if config.variant == "policy" else config.variant
    config = dataclasses.replace(config, preset=preset, variant=variant)
    show(f"paper      preset {preset}, variant {variant}")
    if config.encoder or config.encoder_weights:
        return config
    network = make_settings(preset, variant).network
    sizes = f"{network.scene_encoder}-{network.object_features}-{network.object_points}"
    folder = config.folder.parent / f"encoder-{sizes}"
    pretrain_for(network, folder, show)
    return dataclasses.replace(config, encoder_weights=str(folder))


def run_training(
    config: TrainConfig,
    settings: Settings | None = None,
    show: Callable[[str], None] = print,
    interrupt: Interrupt | None = None,
) -> Path:
    """One run to its end; the policy's folder. See `cluttergen_jax.train`.

    Args:
      settings: in place of `config.settings()`, for an experiment that changes more than an argument does.
      interrupt: who asks for a stop, in place of Ctrl-C alone.
    """
    with _hold_run(config.folder):
        return _run(config, settings, show, interrupt)


@contextmanager
def _hold_run(folder: Path) -> Iterator[None]:
    """`hold_run` by the process that writes; where it cannot, all that train together are refused."""
    import jax

    with ExitStack() as stack:
        refusal = None
        try:
            if jax.process_index() == 0:
                stack.enter_context(hold_run(folder))
        except ClutterGenError as error:
            refusal = error
        if jax.process_count() > 1:
            from cluttergen_jax.learning.ppo.sharding import agree

            is_refused = agree(refusal is not None).any()
            if is_refused and refusal is None:
                raise BankError(f"{folder} cannot be written by the first of the processes")
        if refusal is not None:
            raise refusal
        yield


def _run(
    config: TrainConfig,
    settings: Settings | None,
    show: Callable[[str], None],
    interrupt: Interrupt | None,
) -> Path:
    # Brax takes seconds to import, and only who trains needs it.
    from cluttergen_jax.learning.ppo.sharding import is_writer
    from cluttergen_jax.learning.training.run import Evaluator, Run, RunConfig

    settings = settings or config.settings()
    lanes = settings.ppo.num_envs
    threads = config.problem.num_threads
    engine = engine_of(config.problem.engine, settings.stability, lanes, threads)
    problem = make_problem(
        dataclasses.replace(
            config.problem,
            engine=engine,
            placement=settings.placement,
            stability=settings.stability,
        )
    )
    folder = RunFolder(config.folder, recipe_of(config, settings))
    say = show if is_writer() else lambda text: None
    say(f"run        {config.folder}")
    duration = _simulation_time(settings, engine, threads)
    say(f"engine     {engine}, {lanes:,} environments side by side{duration}")
    is_sampled = config.eval_action != "mean"
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
        folder,
        evaluate if config.eval_episodes else None,
        None if config.encoder_weights is None else Path(config.encoder_weights),
        evaluate.random if config.eval_episodes else None,
    ).train(show, interrupt)
    say(f"done       policy in {config.folder / 'policy'}, curve in {config.folder / 'curve.png'}")
    return config.folder / "policy"


def _simulation_time(settings: Settings, engine: str, num_threads: int) -> str:
    """How long the simulation of a run takes, where that was measured."""
    if engine == "jax":
        return ""
    stability = settings.stability
    ppo = settings.ppo
    steps = stability.decision_step if stability.stop_when_decided else stability.max_steps
    rounds = ppo.num_attempts / ppo.num_envs
    seconds = rounds * steps * step_seconds(engine, ppo.num_envs, num_threads)
    return f": simulating {ppo.num_attempts:,} attempts takes about {time_text(seconds)}, learning aside"


def recipe_of(config: TrainConfig, settings: Settings) -> Record:
    """What a checkpoint says of how it was made."""
    asked = dataclasses.asdict(config.problem)
    return {
        **{name: asked[name] for name in _ASKED},
        "pool_hash": find_pool(config.problem.pool).hash,
        "variant": config.variant,
        "encoder_weights": config.encoder_weights,
        "preset": config.preset,
        "seed": config.seed,
        **dataclasses.asdict(settings),
        "placement": placement_record(settings.placement),
        "stability": stability_record(settings.stability),
        "versions": versions(),
        "kind": KIND,
    }
