"""Presets of heads: sizes, and how they are fitted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

from cluttergen_jax.config import PlacerHead
from cluttergen_jax.downstream.fitting.fit import FitConfig
from cluttergen_jax.downstream.placer.heads.head import Head
from cluttergen_jax.downstream.placer.heads.mixture import MixtureHead
from cluttergen_jax.downstream.placer.heads.regression import RegressionConfig, RegressionHead
from cluttergen_jax.downstream.placer.heads.scored import ScoredHead
from cluttergen_jax.downstream.placer.query import NUM_OBJECT_POINTS, NUM_POINTS
from cluttergen_jax.errors import ConfigError, closest

_REGRESSION_CPU = FitConfig(
    num_epochs=60, batch_size=40, learning_rate=1e-3, schedule="linear", weight_decay=0.0
)
_PRESETS: Mapping[tuple[str, str], tuple[Head, FitConfig]] = {
    ("scored", "cpu"): (ScoredHead(), FitConfig()),
    ("mixture", "cpu"): (MixtureHead(), FitConfig(num_epochs=20)),
    ("regression", "cpu"): (RegressionHead(), _REGRESSION_CPU),
    # As the published code has it: one group of all points, 1,024 features of either cloud.
    ("regression", "paper"): (
        RegressionHead(
            RegressionConfig(features=1024, scene_points=NUM_POINTS, object_points=NUM_OBJECT_POINTS)
        ),
        replace(_REGRESSION_CPU, num_epochs=1000),
    ),
}


def preset(
    head: str, name: str, loss: str, encoder_weights: Path | None, **fit: Any
) -> tuple[Head, FitConfig]:
    """The head and how it is fitted.

    Args:
      name: of the preset.
      loss, encoder_weights: of `regression` alone.
      fit: fields of `FitConfig`; None leaves the preset's.

    Raises:
      ConfigError: there is no such head or preset, or an option is not the head's.
    """
    heads = get_args(PlacerHead)
    if head not in heads:
        raise ConfigError(f"head {head!r}", ", ".join(heads), "head='scored'", closest(head, heads))
    known = [each for of, each in _PRESETS if of == head]
    if name not in known:
        raise ConfigError(
            f"preset {name!r} of head {head!r}",
            ", ".join(known),
            f"preset={known[0]!r}",
            closest(name, known),
        )
    found, config = _PRESETS[head, name]
    if isinstance(found, RegressionHead):
        sizes = replace(found.config, loss=_known_loss(loss))
        found = RegressionHead(sizes, encoder_weights)
    elif loss != "printed" or encoder_weights is not None:
        given = f"loss = {loss!r}" if loss != "printed" else f"`encoder_weights` = {encoder_weights}"
        raise ConfigError(
            f"{given} with head {head!r}", "neither: they are of 'regression'", "leaving it out"
        )
    unknown = set(fit) - {each.name for each in fields(FitConfig)}
    assert not unknown, unknown
    return found, replace(config, **{key: value for key, value in fit.items() if value is not None})


def _known_loss(loss: str) -> Any:
    if loss not in ("printed", "symmetric"):
        raise ConfigError(f"loss = {loss!r}", "'printed' or 'symmetric'", "loss='printed'")
    return loss
