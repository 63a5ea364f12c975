"""Evaluation: trials and what is measured of them, methods side by side.

trial: what one row asks. resolved: what its names stand for, its policy among them. runner: makes its row.
store: rows on disk, found again by content. records: what these hold. comparison: methods side by side.
diversity: how far scenes are from each other.
"""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.evaluation.diversity import embed
    from cluttergen_jax.evaluation.records import versions
    from cluttergen_jax.evaluation.store import Store, json_bytes

__getattr__, __all__ = offer(
    __name__,
    {
        "diversity": ("embed",),
        "records": ("versions",),
        "store": ("Store", "json_bytes"),
    },
)
