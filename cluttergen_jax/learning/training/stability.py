"""Fitting the stability network to labelled attempts, and how well its trust is calibrated."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.networks.stability import (
    NUM_FEATURES,
    StabilityNet,
    StabilityNetConfig,
    StabilityPrediction,
    features_of,
)
from cluttergen_jax.learning.policies.guided import Guided
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.candidate_sampler import CandidateSet
from cluttergen_jax.placement.region import action_scale
from cluttergen_jax.placement.rules import Rules
from cluttergen_jax.placement.search import Candidates
from cluttergen_jax.placement.types import Episode, Transition
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
class FitConfig:
    """How the network is fitted.

    Attributes:
      num_epochs, batch_size, learning_rate: of the optimisation (AdamW, the rate falling as a cosine).
    """

    num_epochs: int = 8
    batch_size: int = 256
    learning_rate: float = 2e-3


def fit(
    network: StabilityNetConfig, config: FitConfig, examples: Examples, seed: int
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
