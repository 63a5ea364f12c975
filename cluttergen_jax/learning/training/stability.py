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

from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.networks.stability import (
    NUM_FEATURES,
    StabilityNet,
    StabilityNetConfig,
    StabilityPrediction,
)
from cluttergen_jax.learning.training.attempts import Examples
from cluttergen_jax.numerics import new_key
from cluttergen_jax.types import Array

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


def fit(network: StabilityNetConfig, config: FitConfig, examples: Examples, seed: int) -> tuple[Any, float]:
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

    yes, no = int(label.sum()), int((~label).sum())
    if not yes or not no:
        return float("nan")
    return float((rankdata(score)[label].sum() - yes * (yes + 1) / 2) / (yes * no))


def predictions_of(network: StabilityNetConfig, params: Any, examples: Examples) -> StabilityPrediction:
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
        trust, stood = np.array(each.trust)[is_there], np.array(each.stood)[is_there]
        axis.plot(trust, stood, marker="o", markersize=4, label=f"{name}: AUC {each.auc:.3f}")
    axis.set(xlabel="trust before the attempt", ylabel="share that stood", xlim=(0, 1), ylim=(0, 1))
    axis.set_title(f"{max(each.number for each in found.values()):,} {of}", fontsize=9)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper left")
    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120)
    write_atomically(path, picture.getvalue())
