"""Training of `guided`: rounds of attempts among variants of the modeller, each with the network so far."""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from cluttergen_jax.config import ROBUST_TILT, StabilityConfig, check_range
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.networks.stability import NUM_FEATURES, StabilityNetConfig
from cluttergen_jax.learning.policies.guided import KIND, blank_params
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.training.run_folder import Interrupt, RunFolder, hold_run, versions
from cluttergen_jax.learning.training.stability import (
    Examples,
    Explorer,
    FitConfig,
    begin,
    calibration,
    collect_step,
    draw_calibration,
    fit,
    predictions_of,
)
from cluttergen_jax.learning.training.variants import HELD_OUT_FAMILIES, TRAINING_FAMILIES, variants
from cluttergen_jax.learning.training.worlds import (
    SET_SIZE,
    TrainingSetting,
    TrainingWorld,
    WorldMaker,
    draw_settings,
    mean_footprint,
    object_sets,
)
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.config import MIN_MARGIN, PlacementConfig, placement_record
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.progress import Progress
from cluttergen_jax.schema import Numbers, check_numbers

PLACEMENT = PlacementConfig(order="weighted", ruin_after=3, min_margin=MIN_MARGIN, history_stride=0)
"""What is asked of the episodes: as of `generate`, but scenes are taken apart sooner, to see more of them."""
_TEST_SHARE = 4
"""The test on held-out families is so many times shorter than a round."""
HELD_OUT_SEED = 1000
"""Seeds of held-out variants begin here: no training reaches so far."""


@dataclass(frozen=True)
class GuidedConfig:
    """A training of the stability network.

    Attributes:
      network, fit: its sizes, and how it is fitted.
      num_rounds: of attempts; before each the network is fitted to all that there are.
      num_settings: supports and crowds; every second one asks for robust scenes.
      num_attempts: of a round in all.
      num_episodes: side by side.
      exploration: how often an attempt tries any candidate.
      num_variants, num_held_out: objects to learn from, and of families held out to test with.
      seed: of worlds, episodes and weights.
    """

    network: StabilityNetConfig = field(default_factory=StabilityNetConfig)
    fit: FitConfig = field(default_factory=FitConfig)
    num_rounds: int = 6
    num_settings: int = 10
    num_attempts: int = 16_000
    num_episodes: int = 32
    exploration: float = 0.3
    num_variants: int = 640
    num_held_out: int = 60
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("num_rounds", "num_settings", "num_attempts", "num_episodes"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}", "1 or more")
        for name in ("num_variants", "num_held_out"):
            if getattr(self, name) < SET_SIZE:
                raise ConfigError(f"{name} = {getattr(self, name)}", f"{SET_SIZE} or more")
        if self.num_steps < 1:
            raise ConfigError(
                f"{self.num_attempts} attempts a round",
                f"{self.num_episodes * self.num_settings} attempts or more",
            )

    @property
    def num_steps(self) -> int:
        """Attempts of each episode in one setting and round."""
        return self.num_attempts // (self.num_settings * self.num_episodes)


def train_guided(
    num_attempts: int | None, seed: int, out: str | Path | None, show: Callable[[str], None]
) -> Path:
    """`cluttergen_jax.train(variant="guided")`; the policy's folder. See `GuidedTraining`."""
    check_range("seed", seed, 0, 2**32 - 1, 0)
    config = GuidedConfig(seed=seed)
    if num_attempts is not None:
        least = config.num_rounds * config.num_settings * config.num_episodes
        check_range("num_attempts", num_attempts, least, 10**9, 96_000)
        config = replace(config, num_attempts=num_attempts // config.num_rounds)
    folder = Path(out or f"runs/guided-{seed}")
    show(f"run        {folder}")
    with hold_run(folder):
        return GuidedTraining(config, folder, show).run()


class GuidedTraining:
    """A run in a folder: `attempts/` (what was seen, by round and setting), `policy/` (what is made of it).

    Args:
      config: what is learned from how much.
      folder: continued if it holds a run with the same config.
      show: is given the lines that tell how far the run is.

    Raises:
      ConfigError: the folder holds a run with another config.
    """

    def __init__(
        self, config: GuidedConfig, folder: Path, show: Callable[[str], None] = print
    ) -> None:
        self.config = config
        self.folder = folder
        self._show = show
        run = RunFolder(folder, {"config": asdict(config)})
        (folder / "attempts").mkdir(parents=True, exist_ok=True)
        # What was seen lies in files of its own; the state says that it is begun, and how.
        run.save({"begun": np.ones(1)})
        self._step = jax.jit(collect_step, donate_argnums=1)

    def run(self) -> Path:
        """The policy's folder, after the last round.

        Raises:
          KeyboardInterrupt: on Ctrl-C; what was seen in the settings that are done is kept.
        """
        config = self.config
        started = time.monotonic()
        families = (TRAINING_FAMILIES, config.num_variants, 0)
        crowds = _Crowds(config, families, config.num_rounds, config.seed)
        params = blank_params(config.network)
        examples = []
        with Interrupt() as interrupt:
            for number in range(config.num_rounds):
                # Weights of nothing but zeros trust no one: the first round tries everything.
                exploration = config.exploration if number else 1.0
                name = f"{number:02d}"
                examples += self._see(
                    crowds, number, name, params, exploration, config.num_steps, interrupt
                )
                params, loss = fit(config.network, config.fit, _concatenate(examples), config.seed)
                self._show(f"round {number + 1}    {_summary(examples)}, loss {loss:.3f}")
            families = (HELD_OUT_FAMILIES, config.num_held_out, HELD_OUT_SEED)
            held_out = _Crowds(config, families, 1, config.seed + 1)
            num_steps = -(-config.num_steps // _TEST_SHARE)
            seen = self._see(
                held_out, 0, "held-out", params, config.exploration, num_steps, interrupt
            )
        self._save(params, examples, _concatenate(seen))
        self._show(
            f"time       {(time.monotonic() - started) / 60:.1f} minutes; policy in {self.folder / 'policy'}"
        )
        return self.folder / "policy"

    def _see(
        self,
        crowds: _Crowds,
        number: int,
        name: str,
        params: Any,
        exploration: float,
        num_steps: int,
        interrupt: Interrupt,
    ) -> list[Examples]:
        """The attempts of a round, by setting: from their files, or made now."""
        config = self.config
        seen = []
        total = config.num_settings * num_steps * config.num_episodes
        with Progress(f"attempts {name}", total, "attempt") as progress:
            for index in range(config.num_settings):
                file = self.folder / "attempts" / f"{name}-{index:02d}.npz"
                if file.exists():
                    seen.append(_read(file))
                    progress.update(len(seen[-1].features))
                    continue
                world = crowds.world(number, index)
                key = jax.random.fold_in(new_key(config.seed), crowds.number_of(number, index))
                explorer = Explorer(
                    LowestFit(world.rules, mapper=world.mapper),
                    params=params,
                    network=config.network,
                    exploration=np.float32(exploration),
                )
                seen.append(self._collect(explorer, key, num_steps, progress, interrupt))
                _write(file, seen[-1])
        return seen

    def _collect(
        self, explorer: Explorer, key: Any, num_steps: int, progress: Progress, interrupt: Interrupt
    ) -> Examples:
        rows = []
        episodes = begin(explorer, key, self.config.num_episodes)
        for _ in range(num_steps):
            if interrupt.is_asked:
                raise KeyboardInterrupt
            episodes, row = interrupt.run_compiling(self._step, explorer, episodes)
            rows.append(jax.device_get(row))
            progress.update(self.config.num_episodes)
        return _concatenate(rows)

    def _save(self, params: Any, examples: list[Examples], tested: Examples) -> None:
        config = self.config
        folder = self.folder / "policy"
        predicted = predictions_of(config.network, params, tested)
        found = calibration(predicted.stands, tested.stands, tested.is_on)
        known = tested.knows_robust
        robust = calibration(
            predicted.is_robust[known], tested.is_robust[known], tested.is_on[known]
        )
        self._show(f"held out   {found}")
        self._show(f"robust     {robust}")
        record = {
            "kind": KIND,
            "variant": "guided",
            "config": asdict(config),
            "network": asdict(config.network),
            "placement": placement_record(PLACEMENT),
            "num_attempts": len(_concatenate(examples).features),
            "families": TRAINING_FAMILIES,
            "held_out_families": HELD_OUT_FAMILIES,
            "held_out": {"stands": asdict(found), "robust": asdict(robust)},
            "versions": versions(),
        }
        folder.mkdir(parents=True, exist_ok=True)
        draw_calibration(
            {"stands": found, "stands under change": robust}, folder / "calibration.png"
        )
        # Last: a folder with a record is a run that is done.
        save_policy(folder, params, record)


class _Crowds:
    """The worlds of some rounds: settings of one draw, other objects each time."""

    def __init__(
        self,
        config: GuidedConfig,
        families: tuple[Sequence[str], int, int],
        num_rounds: int,
        seed: int,
    ) -> None:
        self.config = config
        self._families = families
        self._num_rounds = num_rounds
        self._seed = seed

    @cached_property
    def _made(self) -> tuple[WorldMaker, list[TrainingSetting]]:
        """Made when the first world is asked for: a run that has seen all needs none."""
        names, number, first_seed = self._families
        objects = variants(number, first_seed, names)
        rng = np.random.default_rng(self._seed)
        settings = draw_settings(rng, self.config.num_settings, mean_footprint(objects))
        sets = object_sets(objects, self._num_rounds * self.config.num_settings, rng)
        return WorldMaker(sets, PLACEMENT), settings

    def number_of(self, number: int, index: int) -> int:
        """Of a setting in a round, among all; the seed makes it another for other objects."""
        return (1000 * self._seed + number * self.config.num_settings + index) % 2**32

    def world(self, number: int, index: int) -> TrainingWorld:
        """The world of setting `index` in round `number`, its engine started."""
        maker, settings = self._made
        stability = StabilityConfig(robust_tilt=ROBUST_TILT if index % 2 else 0.0)
        world = maker.make(settings[index], number * self.config.num_settings + index, stability)
        world.start_engine()
        return world


def _concatenate(examples: Sequence[Examples]) -> Examples:
    return jax.tree.map(lambda *parts: np.concatenate(parts), *examples)


def _summary(examples: Sequence[Examples]) -> str:
    every = _concatenate(examples)
    on = every.stands[every.is_on].mean() if every.is_on.any() else float("nan")
    return f"{len(every.features):,} attempts, {every.stands.mean():.3f} stood, {on:.3f} of those on objects"


def _write(file: Path, examples: Examples) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **dataclasses.asdict(examples))
    write_atomically(file, buffer.getvalue())


_NUMBERS = {
    "features": Numbers("f4", ("attempts", NUM_FEATURES)),
    "shift": Numbers("f4", ("attempts",), 0.0, 0.11),
    "margin": Numbers("f4", ("attempts",), -0.11, 0.11),
    **{
        name: Numbers("bool", ("attempts",))
        for name in ("stands", "is_robust", "knows_robust", "disturbs", "is_on")
    },
}
"""What a file of attempts holds."""


def _read(file: Path) -> Examples:
    """The attempts in a file; PoolError where it is damaged."""
    # A damaged archive makes zipfile, zlib and NumPy raise whatever they like.
    try:
        with np.load(file, allow_pickle=False) as stored:
            found = {each.name: stored[each.name] for each in dataclasses.fields(Examples)}
        check_numbers(found, _NUMBERS)
        return Examples(**found)
    except Exception as error:
        raise PoolError(
            f"{file} cannot be read ({error})", hint="deleting it: it is made again"
        ) from error
