"""`cluttergen train`: the policy, from scratch or from where it stopped."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from cluttergen_jax.agent.checkpoint import read_record
from cluttergen_jax.agent.config import PPOConfig
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.problem import ProblemConfig, make_problem
from cluttergen_jax.training.presets import Settings, make_settings


@dataclass(frozen=True)
class Train:
    """Train a placement policy with PPO. The same command takes an interrupted run up again.

    Attributes:
      pool: a pool's name or folder.
      support: a support's name or folder; table-0.40x0.50 is a cuboid of that size.
      num_objects: objects per scene.
      attempts: per object, 1 to 10.
      preset: cpu, gpu or paper.
      variant: policy (the full method), open_loop, short_memory or normal.
      num_attempts: environment steps of the run; the preset's if not given.
      seed: of weights, episodes and actions.
      reward: paper, code or compressed; the preset's if not given.
      out: the run's folder; runs/POOL-VARIANT-SEED if not given.
      engine: auto, native, warp or jax.
    """

    pool: str = "dining"
    support: str = "table"
    num_objects: int = 10
    attempts: int = 5
    preset: str = "cpu"
    variant: str = "policy"
    num_attempts: int | None = None
    seed: int = 0
    reward: str | None = None
    out: str | None = None
    engine: str = "auto"

    def run(self) -> int:
        """Runs the command; the exit status."""
        # Brax takes seconds to import, and only who trains needs it.
        from cluttergen_jax.training.run import Run, RunConfig

        settings = self._settings()
        problem = make_problem(
            ProblemConfig(
                pool=self.pool,
                support=self.support,
                engine=self.engine,
                placement=settings.placement,
                stability=settings.stability,
            )
        )
        folder = Path(self.out or f"runs/{Path(self.pool).name}-{self.variant}-{self.seed}")
        recipe = recipe_of(self, settings)
        _check_folder(folder, recipe)
        print(f"run        {folder}")
        config = RunConfig(seed=self.seed)
        Run(problem.rules, settings.network, settings.ppo, config, folder, recipe).train()
        print(f"done       policy in {folder / 'policy'}, curve in {folder / 'curve.png'}")
        return 0

    def _settings(self) -> Settings:
        settings = make_settings(self.preset, self.variant)
        placement = dataclasses.replace(
            settings.placement, num_objects=self.num_objects, max_attempts=self.attempts
        )
        if self.reward is not None:
            placement = dataclasses.replace(placement, reward=self.reward)
        ppo: PPOConfig = settings.ppo
        if self.num_attempts is not None:
            ppo = dataclasses.replace(ppo, num_attempts=self.num_attempts)
        return dataclasses.replace(settings, placement=placement, ppo=ppo)


def recipe_of(args: Train, settings: Settings) -> dict[str, Any]:
    """What a checkpoint says of how it was made."""
    return {
        "pool": args.pool,
        "pool_hash": find_pool(args.pool).hash,
        "support": args.support,
        "variant": args.variant,
        "preset": args.preset,
        "seed": args.seed,
        **dataclasses.asdict(settings),
        "versions": {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax", "flax")},
    }


def _check_folder(folder: Path, recipe: dict[str, Any]) -> None:
    """Refuses to continue a run that was made with other settings."""
    if not (folder / "last").exists():
        return
    theirs = read_record(folder / "last")
    changed = sorted(name for name, value in recipe.items() if theirs.get(name) != _as_json(value))
    if changed:
        raise ConfigError(
            f"{folder} holds a run with another {', '.join(changed)}",
            "the same settings, which continue it",
            "another --out",
        )


def _as_json(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _as_json(each) for name, each in value.items()}
    return list(value) if isinstance(value, tuple) else value
