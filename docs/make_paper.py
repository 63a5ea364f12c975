"""Writes docs/concepts/paper.md, the paper's settings beside the presets': python docs/make_paper.py."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from cluttergen_jax.config import Preset
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.training.presets import Settings, make_settings
from cluttergen_jax.tables import markdown_table

PAGE = Path(__file__).parent / "concepts" / "paper.md"
PRESETS: tuple[Preset, ...] = ("paper", "paper_code", "paper_cpu", "cpu")
SAME = "as printed"


class Row(NamedTuple):
    """One setting: what it is, what the paper prints, what its published code has, and what a preset has."""

    what: str
    printed: str
    code: str
    of: Callable[[Settings], object]


def _weight_of_square(settings: Settings) -> float:
    return settings.ppo.value_cost / 2


def _falls(settings: Settings) -> str:
    return f"{settings.ppo.learning_rate:g}{', falls to 0' if settings.ppo.anneals else ''}"


def _history(settings: Settings) -> str:
    network = settings.network
    return f"3 layers of {network.history_width}" if network.history_width else "none"


def _cloud(settings: Settings) -> str:
    network = settings.network
    return (
        f"{network.scene_points:,} points"
        if network.reads_clouds
        else "none: the set of placed objects"
    )


def _encoder(settings: Settings) -> str:
    network = settings.network
    kind = {"pointnet2": "PointNet++", "pointnet": "PointNet", "set": "attention over objects"}
    weights = "kept as pretrained" if network.encoder_frozen else "trained along"
    return f"{kind[network.scene_encoder]}, {weights}"


def _layers(settings: Settings) -> str:
    return f"{settings.network.num_layers + 1} of {settings.network.width}, the last is the output"


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):g}"


ROWS = (
    Row(
        "scene's encoder",
        "PointNet++, kept as pretrained",
        "PointNet (groups of all points), kept",
        _encoder,
    ),
    Row("scene's cloud", "20,480 points of the scene with its support", SAME, _cloud),
    Row("object's cloud", "1,024 points", SAME, lambda s: f"{s.network.object_points:,} points"),
    Row("history encoder", "3 layers of 256", "2 layers, off unless asked for", _history),
    Row(
        "rows of an attempt's trajectory",
        "all",
        SAME,
        lambda s: {1: "all"}.get(
            s.placement.history_stride, f"every {s.placement.history_stride}th"
        ),
    ),
    Row("actor, critic", "5 layers of 256", "5, the last is the output; tanh", _layers),
    Row("distribution", "Beta", "Beta, alpha and beta of any size", lambda s: s.network.head),
    Row(
        "reward",
        "its equation 1",
        "no acceleration; 1,000 more for the last object",
        lambda s: s.placement.reward,
    ),
    Row("unit of rewards", "1", "1", lambda s: f"{s.ppo.reward_scale:g}"),
    Row("rewards cut off at", "no bound", "no bound", lambda s: s.ppo.reward_limit or "no bound"),
    Row("weight of the mean square of values' errors", "0.5", "0.25", _weight_of_square),
    Row("values clipped at", "not said", "0.2", lambda s: s.ppo.value_clip or "not clipped"),
    Row("entropy bonus", "0.01", SAME, lambda s: f"{s.ppo.entropy_cost:g}"),
    Row("learning rate", "1e-4", "1e-4, falls to 0", _falls),
    Row("epochs", "5", "10", lambda s: s.ppo.num_epochs),
    Row("minibatch", "1,000", SAME, lambda s: f"{s.ppo.steps_of_minibatch:,}"),
    Row(
        "discount, lambda",
        "0.99, 0.95",
        SAME,
        lambda s: f"{s.ppo.discount:g}, {s.ppo.gae_lambda:g}",
    ),
    Row(
        "environments x attempts of a rollout",
        "not said",
        "16 x 200",
        lambda s: f"{s.ppo.num_envs} x {s.ppo.num_steps}",
    ),
    Row("attempts of a training", "2,500,000", SAME, lambda s: f"{s.ppo.num_attempts:,}"),
    Row(
        "neighbours are judged",
        "not said",
        "no",
        lambda s: "yes" if s.stability.judge_neighbours else "no",
    ),
    Row(
        "thresholds hold for",
        "the norm",
        "each axis",
        lambda s: "each axis" if s.stability.per_axis else "the norm",
    ),
    Row(
        "an attempt ends",
        "after 240 steps",
        "as soon as it is decided",
        lambda s: (
            "as soon as it is decided" if s.stability.stop_when_decided else "after 240 steps"
        ),
    ),
)

HEAD = """\
# The paper's method, setting by setting

What the paper prints, what its published code does instead (generalroboticslab/ClutterGen, commit 82a52e4),
and what each preset of `python train.py` has (variant `beta_free`; for `cpu` its own head). `python
docs/make_paper.py` writes this table from the presets, and a test holds it to them.

"""

FOOT = """

What no preset has as the paper does:

- **Pretraining.** The paper's encoder comes from ModelNet40, which may not be passed on; ours learns to
  tell the modeller's 50 families of tabletop objects apart (`cluttergen pretrain`).
- **The scene's cloud** is of the top inside the queried region and of the objects placed; sides and legs of
  the support, and the top beyond the region, are left out. The objects' points are theirs whole, as if seen
  from all sides.
- **Layers.** Their nonlinearity is tanh, which the published code takes unless it is asked for ReLU.
- **The reward.** Penalties of more than ten successes are cut off in `paper` and `paper_cpu`: of an object
  that is let go inside another the printed sum of accelerations knows no bound, and nothing is learned
  beside it. Their unit is 1,000 rewards, which only the critic sees, since advantages are normalised.

What counts as stable is stricter than in the paper by default ([words and numbers](../contract.md));
`--setting paper` of `generate` and `evaluate` counts as the paper does.
"""


def page() -> str:
    """The page's text."""
    settings = [
        make_settings(preset, "policy" if preset == "cpu" else "beta_free") for preset in PRESETS
    ]
    header = ["setting", "printed", "the authors' code", *(f"`{preset}`" for preset in PRESETS)]
    rows = [
        [row.what, row.printed, row.code, *(str(row.of(each)) for each in settings)] for row in ROWS
    ]
    return HEAD + markdown_table(header, rows) + FOOT


if __name__ == "__main__":
    write_atomically(PAGE, page().encode())
