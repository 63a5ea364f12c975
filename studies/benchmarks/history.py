"""Whether a policy that looks back on its failures is better for what it remembers, or for what it learns.

    cluttergen import GROUP --pool paper_study                      the authors' studying objects
    cluttergen pretrain --encoder pointnet --features 256 --object-points 256 --out encoder
    python -m studies.benchmarks.history --encoder-weights encoder --num-attempts 600000 --write

The paper's open loop succeeds in 0.145 of these scenes, its full method in 0.874; with preset `paper_cpu`
they have 0.789 and 0.900 here. Two rows are of the published code's own settings, whose penalties know no
bound; two are the same but for the unit of the reward and its cut-off. If the open loop falls with the first
and rises with the second, the paper's ablation shows what is learned from unbounded penalties, and not what
memory is worth. Clouds are as small as in `paper_cpu`. A row that was trained is kept in `--out`.
"""

from __future__ import annotations

from typing import Any

from cluttergen_jax.learning.training.presets import paper_cpu
from studies.benchmarks.ablation import Row, compare

_SIZES = (
    "scene_encoder",
    "object_points",
    "object_features",
    "scene_points",
    "scene_features",
    "history_width",
)
_CUT = {"reward_scale": 1e-3, "reward_limit": 1.0}


def _code(name: str, title: str, variant: str, **ppo: Any) -> Row:
    """The published code's settings, and as there, unlike its preset, an attempt ends when it is decided."""
    small = paper_cpu()
    return Row(
        name,
        title,
        variant=variant,
        preset="paper_code",
        network={each: getattr(small.network, each) for each in _SIZES},
        placement={"history_stride": small.placement.history_stride},
        stability={"stop_when_decided": True},
        ppo=ppo,
    )


ROWS = (
    _code("code-open_loop", "preset `paper_code`, no history", "open_loop"),
    _code("code-full", "preset `paper_code`, all failures", "beta_free"),
    _code("cut-open_loop", "rewards in thousands, cut off at 1; no history", "open_loop", **_CUT),
    _code("cut-full", "rewards in thousands, cut off at 1; all failures", "beta_free", **_CUT),
)


if __name__ == "__main__":
    compare(
        ROWS,
        "history",
        "What the history is worth, and what the reward",
        "paper_study",
        __doc__,
        needs_encoder=True,
        num_objects=9,
        differs="all but history and reward is equal",
    )
