"""Evaluation: trials and their measures, methods side by side, certificates of banks.

trial: what one row asks. resolved: what its names stand for, its policy among them. episodes: running it, and
its figures. store: rows on disk, found again by content. runner: all of these. comparison: methods side by
side. cells, plots: columns and figures. certify: stability certificates of banks.
"""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.evaluation.machine import versions
    from cluttergen_jax.evaluation.measures.diversity import embed
    from cluttergen_jax.evaluation.store import Store, json_bytes

__getattr__, __all__ = offer(
    __name__,
    {
        "machine": ("versions",),
        "measures.diversity": ("embed",),
        "store": ("Store", "json_bytes"),
    },
)
