"""Training of `guided`: rounds of attempts among varied shapes, each with the network so far."""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.config import ROBUST_TILT, StabilityConfig, check_positive, check_range
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.policies.guided import (
    KIND,
    NUM_FEATURES,
    Guided,
    StabilityNet,
    StabilityNetConfig,
    StabilityPrediction,
    blank_params,
    features_of,
)
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.training.run_folder import Interrupt, RunFolder, hold_run, versions
from cluttergen_jax.learning.training.worlds import (
    HELD_OUT_FAMILIES,
    SET_SIZE,
    TRAINING_FAMILIES,
    TrainingSetting,
    TrainingWorld,
    WorldMaker,
    draw_settings,
    mean_footprint,
    object_sets,
    variants,
)
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement import Candidates, LowestFit, Rules
from cluttergen_jax.placement.candidate_sampler import CandidateSet
from cluttergen_jax.placement.config import MIN_MARGIN, PlacementConfig, placement_record
from cluttergen_jax.placement.region import action_scale
from cluttergen_jax.placement.types import Episode, Transition
from cluttergen_jax.progress import Progress
from cluttergen_jax.schema import Numbers, check_numbers
from cluttergen_jax.types import Array, Verdict

_FAR = 0.1


class Examples(struct.PyTreeNode):
    """N attempts, arrays of JAX or NumPy.

    Attributes:
      features: f32[N, NUM_FEATURES], of the pose that was tried (`features_of`).
      stands: bool[N], it was stable, with the support margin that the rules ask for.
      is_robust: bool[N], it was, and stayed so under change; knows_robust: bool[N], where that was looked at.
      disturbs: bool[N], a placed object was moved.
      shift: f32[N], metres in plan from where the object was released to where it came to rest, at most 0.1.
      margin: f32[N], metres, its support margin at rest, -0.1 to 0.1; 0 where it did not come to rest.
      is_on: bool[N], it would have been carried by another object.
    """

    features: Array
    stands: Array
    is_robust: Array
    knows_robust: Array
    disturbs: Array
    shift: Array
    margin: Array
    is_on: Array


class Explorer(Guided, eq=False):
    """A guided placer that sometimes tries any candidate, so that its network sees what it mistrusts.

    Attributes:
      exploration: f32, how often.
    """

    exploration: Any = 0.3

    def trust(self, episode: Episode, candidates: CandidateSet) -> Array:
        """See `CandidateSampler`: the network's trust, or one in everything."""
        key = jax.random.fold_in(episode.key, 3)
        tries_any = jax.random.uniform(key) < self.exploration
        return jnp.where(tries_any, 1.0, Guided.trust(self, episode, candidates))


def begin(explorer: Explorer, key: Array, number: int) -> Episode:
    """So many fresh episodes of the explorer's rules, side by side."""
    return _begin(explorer.search.rules, jax.random.split(key, number))


@jax.jit
def _begin(rules: Rules, keys: Array) -> Episode:
    return jax.vmap(lambda key: rules.begin(key))(keys)


def collect_step(explorer: Explorer, episodes: Episode) -> tuple[Episode, Examples]:
    """One attempt in each episode, and what it teaches; to be compiled."""
    return jax.vmap(_step, (None, 0))(explorer, episodes)


def _step(explorer: Explorer, episode: Episode) -> tuple[Episode, Examples]:
    rules = explorer.search.rules
    key_propose, key_next, key_begin = jax.random.split(episode.key, 3)
    action = explorer(key_propose, episode)
    after, transition = rules.attempt(episode.replace(key=key_next), action)
    fresh = rules.begin(key_begin)
    next_episode = jax.tree.map(lambda new, old: jnp.where(after.is_over, new, old), fresh, after)
    return next_episode, example_of(explorer, episode, transition)


def example_of(explorer: Guided, before: Episode, transition: Transition) -> Examples:
    """What one attempt teaches, without a leading axis."""
    rules = explorer.search.rules
    settling = transition.settling
    lower, size = action_scale(before.region, rules.height_range(before))
    xy = (lower + transition.action[:3] * size)[:2]
    candidates = Candidates(xy[None], 2 * jnp.pi * transition.action[3:])
    tried = explorer.look(before, candidates)
    focus = transition.object_index
    released = settling.trajectory[0, :2]
    is_at_rest = settling.is_quiet
    is_stable = transition.verdict == Verdict.STABLE
    is_fragile = transition.verdict == Verdict.FRAGILE
    stands = is_stable | (is_fragile & rules.is_supported(before, focus, settling))
    return Examples(
        features=features_of(rules, before, tried)[0],
        stands=stands,
        is_robust=is_stable,
        knows_robust=jnp.bool_(rules.physics.config.robust_tilt > 0) | ~stands,
        disturbs=transition.verdict == Verdict.DISPLACED,
        shift=jnp.minimum(jnp.linalg.norm(settling.poses[focus, :2] - released), _FAR),
        margin=jnp.where(is_at_rest, jnp.clip(settling.margin[focus], -_FAR, _FAR), 0.0),
        is_on=tried.supporters.is_on[0],
    )


_AUXILIARY = 0.3
"""Weight of the heads that nobody acts upon: they make the hidden layers learn what matters."""
_NUM_BINS = 10


@dataclass(frozen=True)
class StabilityFitConfig:
    """How the network is fitted.

    Attributes:
      num_epochs, batch_size, learning_rate: of the optimisation (AdamW, the rate falling as a cosine).
    """

    num_epochs: int = 8
    batch_size: int = 256
    learning_rate: float = 2e-3


def fit(
    network: StabilityNetConfig, config: StabilityFitConfig, examples: Examples, seed: int
) -> tuple[Any, float]:
    """Weights fitted to examples from the start, and the mean loss of the last epoch."""
    number = len(examples.features)
    num_batches = max(number // config.batch_size, 1)
    schedule = optax.cosine_decay_schedule(config.learning_rate, config.num_epochs * num_batches)
    optimizer = optax.adamw(schedule)
    data = jax.tree.map(jnp.asarray, examples)
    key_init, key_order = jax.random.split(new_key(seed))
    params = StabilityNet(network).init(key_init, jnp.zeros((1, NUM_FEATURES)))

    def step(state: tuple[Any, Any], index: Array) -> tuple[tuple[Any, Any], Array]:
        params, moments = state
        batch = jax.tree.map(lambda leaf: leaf[index], data)
        loss, gradient = jax.value_and_grad(_loss)(params, network, batch)
        change, moments = optimizer.update(gradient, moments, params)
        return (optax.apply_updates(params, change), moments), loss

    def epoch(state: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], Array]:
        order = jax.random.permutation(key, number)[: num_batches * config.batch_size]
        return jax.lax.scan(step, state, order.reshape(num_batches, -1))

    run = jax.jit(lambda state, keys: jax.lax.scan(epoch, state, keys))
    (params, _), losses = run(
        (params, optimizer.init(params)), jax.random.split(key_order, config.num_epochs)
    )
    return jax.device_get(params), float(losses[-1].mean())


def _loss(params: Any, network: StabilityNetConfig, batch: Examples) -> Array:
    predicted: Any = StabilityNet(network).apply(params, batch.features)
    cross_entropy = optax.sigmoid_binary_cross_entropy
    is_robust = cross_entropy(predicted.is_robust, batch.is_robust * 1.0) * batch.knows_robust
    return (
        cross_entropy(predicted.stands, batch.stands * 1.0).mean()
        + is_robust.mean()
        + _AUXILIARY * cross_entropy(predicted.disturbs, batch.disturbs * 1.0).mean()
        + _AUXILIARY * optax.huber_loss(predicted.shift, 10 * batch.shift).mean()
        + _AUXILIARY * optax.huber_loss(predicted.margin, 20 * batch.margin).mean()
    )


@dataclass(frozen=True)
class Calibration:
    """How far a network's trust holds on examples that it was not fitted to.

    Attributes:
      number: of examples; share: of them, what stood.
      auc: area under the ROC curve; auc_on: of those alone that would have lain on other objects.
      brier: mean squared error of the trust.
      trusted: share with a trust above 0.9; precision: of these, what stood.
      trust, stood, count: per bin of trust (tenths): its mean, what stood, how many.
    """

    number: int
    share: float
    auc: float
    auc_on: float
    brier: float
    trusted: float
    precision: float
    trust: tuple[float, ...]
    stood: tuple[float, ...]
    count: tuple[int, ...]

    def __str__(self) -> str:
        return (
            f"{self.number:,} attempts, AUC {self.auc:.3f} ({self.auc_on:.3f} on objects); "
            f"{self.trusted:.3f} trusted above 0.9, of these {self.precision:.3f} stood"
        )


def calibration(logits: np.ndarray, stood: np.ndarray, is_on: np.ndarray) -> Calibration:
    """How far the trust sigmoid(logits), f32[N], agrees with what stood, bool[N]."""
    trust = 1 / (1 + np.exp(-logits.astype(np.float64)))
    place = np.minimum((trust * _NUM_BINS).astype(int), _NUM_BINS - 1)
    count = np.bincount(place, minlength=_NUM_BINS)
    least = np.maximum(count, 1)
    is_trusted = trust > 0.9
    return Calibration(
        number=len(trust),
        share=float(stood.mean()),
        auc=_auc(trust, stood),
        auc_on=_auc(trust[is_on], stood[is_on]),
        brier=float(np.mean((trust - stood) ** 2)),
        trusted=float(is_trusted.mean()),
        precision=float(stood[is_trusted].mean()) if is_trusted.any() else float("nan"),
        trust=tuple((np.bincount(place, trust, _NUM_BINS) / least).tolist()),
        stood=tuple((np.bincount(place, stood, _NUM_BINS) / least).tolist()),
        count=tuple(count.tolist()),
    )


def _auc(score: np.ndarray, label: np.ndarray) -> float:
    """The chance that one that stood has a higher score than one that did not; ties count half."""
    from scipy.stats import rankdata

    yes = int(label.sum())
    no = int((~label).sum())
    if not yes or not no:
        return float("nan")
    return float((rankdata(score)[label].sum() - yes * (yes + 1) / 2) / (yes * no))


def predictions_of(
    network: StabilityNetConfig, params: Any, examples: Examples
) -> StabilityPrediction:
    """What the network expects of examples: NumPy arrays."""
    return jax.device_get(jax.jit(StabilityNet(network).apply)(params, examples.features))


def draw_calibration(
    found: Mapping[str, Calibration], path: Path, of: str = "attempts, held-out families"
) -> None:
    """The picture of what was trusted how far against what stood, a line for each; the diagonal is right.

    Args:
      of: what was judged.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 4.2), layout="constrained")
    axis = figure.add_subplot()
    axis.plot([0, 1], [0, 1], color="gray", linewidth=1, linestyle="--")
    for name, each in found.items():
        is_there = np.array(each.count) > 0
        trust = np.array(each.trust)[is_there]
        stood = np.array(each.stood)[is_there]
        axis.plot(trust, stood, marker="o", markersize=4, label=f"{name}: AUC {each.auc:.3f}")
    axis.set(xlabel="trust before the attempt", ylabel="share that stood", xlim=(0, 1), ylim=(0, 1))
    axis.set_title(f"{max(each.number for each in found.values()):,} {of}", fontsize=9)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper left")
    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120)
    write_atomically(path, picture.getvalue())


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
    fit: StabilityFitConfig = field(default_factory=StabilityFitConfig)
    num_rounds: int = 6
    num_settings: int = 10
    num_attempts: int = 16_000
    num_episodes: int = 32
    exploration: float = 0.3
    num_variants: int = 640
    num_held_out: int = 60
    seed: int = 0

    def __post_init__(self) -> None:
        check_positive(self, "num_rounds", "num_settings", "num_attempts", "num_episodes")
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
    def _maker_and_settings(self) -> tuple[WorldMaker, list[TrainingSetting]]:
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
        maker, settings = self._maker_and_settings
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
