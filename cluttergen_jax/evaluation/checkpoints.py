"""Where the policy behind a row lies: embedded, in a folder of training runs, or one that was named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cluttergen_jax.config import VARIANTS
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.learning.methods import METHODS, checkpoint_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.training.suite import DEFAULT_ATTEMPTS, DEFAULT_OBJECTS
from cluttergen_jax.placement.baselines import BASELINES


class MissingCheckpointError(PoolError):
    """A row's policy has not been trained; `hint` is the command that does it."""


@dataclass(frozen=True)
class Checkpoints:
    """Finds policies.

    Attributes:
      folder: of training runs, POOL-VARIANT[-attemptsA][-SEED], each with its `policy`; None takes embedded
        checkpoints.
      path: the one checkpoint of all learned methods; goes before everything else. A row whose method it
        was not trained as has none.
    """

    folder: Path | None = None
    path: Path | None = None

    def __post_init__(self) -> None:
        if self.folder is not None and not self.folder.is_dir():
            raise ConfigError(
                f"checkpoints = {str(self.folder)!r}",
                "a folder of training runs, such as runs",
                "cluttergen train, which makes runs/POOL-VARIANT-SEED",
            )

    def find(self, trial: Trial) -> Path | None:
        """The folder of the trial's policy; None for a baseline.

        Raises:
          MissingCheckpointError: there is none.
          ConfigError: there is no such method.
        """
        if trial.method not in METHODS or trial.method in BASELINES:
            checkpoint_of(trial.method, trial.pool)
            return None
        path = self._given(trial) or self._in_folder(trial) or self._embedded(trial)
        if path is None:
            raise MissingCheckpointError(
                f"no checkpoint for method {trial.method!r} on pool {trial.pool!r}", hint=train_command(trial)
            )
        return path

    def run_folder(self, trial: Trial) -> Path | None:
        """The training run behind a learned trial, with its progress; None if it is not there."""
        for name in _names(trial):
            if self.folder is not None and (self.folder / name / "progress.csv").is_file():
                return self.folder / name
        return None

    def _given(self, trial: Trial) -> Path | None:
        if self.path is None:
            return None
        try:
            found = checkpoint_of(trial.method, trial.pool, read_checkpoint(self.path))
            return None if found is None else found.path
        except ConfigError as error:
            # Results name no folders.
            name = f"{self.path.parent.name}/{self.path.name}"
            given = error.given.replace(str(self.path), name)
            raise MissingCheckpointError(given, hint=train_command(trial)) from error

    def _in_folder(self, trial: Trial) -> Path | None:
        if self.folder is None:
            return None
        places = [self.folder / name / inner for name in _names(trial) for inner in ("policy", "")]
        return next((place for place in places if (place / "weights.npz").is_file()), None)

    def _embedded(self, trial: Trial) -> Path | None:
        """The embedded ones are of training seed 0; a given folder hides them."""
        if self.folder is not None or trial.training_seed != 0:
            return None
        try:
            found = checkpoint_of(trial.method, trial.pool)
            return None if found is None else found.path
        except PoolError:
            return None


def _names(trial: Trial) -> list[str]:
    """Run folders that a trial's policy may be in, the best first.

    One trained with the trial's attempts goes before one trained with the usual number.
    """
    pool = trial.pool_name
    # Methods that are no variant of the network act with the weights of the full method.
    variants = dict.fromkeys((trial.method, trial.method if trial.method in VARIANTS else "policy"))
    attempts = "" if trial.attempts == DEFAULT_ATTEMPTS else f"-attempts{trial.attempts}"
    stems = [f"{pool}-{variant}{extra}" for extra in dict.fromkeys((attempts, "")) for variant in variants]
    endings = (f"-{trial.training_seed}", *([""] if trial.training_seed == 0 else []))
    return [f"{stem}{ending}" for stem in stems for ending in endings]


def train_command(trial: Trial) -> str:
    """The command that trains what a row lacks."""
    variant = trial.method if trial.method in VARIANTS else "policy"
    words = [f"cluttergen train --pool {trial.pool} --variant {variant}"]
    if trial.training_seed:
        words.append(f"--seed {trial.training_seed}")
    if trial.num_objects < DEFAULT_OBJECTS:
        # Who was trained with more objects fills smaller scenes too; but a pool may have no more.
        words.append(f"--num-objects {trial.num_objects}")
    if trial.attempts != DEFAULT_ATTEMPTS:
        words.append(f"--attempts {trial.attempts} --out runs/{_names(trial)[0]}")
    return " ".join(words)
