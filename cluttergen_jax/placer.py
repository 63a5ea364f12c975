"""Stable placement from one camera's view, as `cluttergen placer`: pairs, training, comparison."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.downstream.placer.api import placer_data as data
    from cluttergen_jax.downstream.placer.api import placer_eval as eval
    from cluttergen_jax.downstream.placer.api import placer_train as train

__all__ = ["data", "eval", "train"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "data": "downstream.placer.api:placer_data",
        "eval": "downstream.placer.api:placer_eval",
        "train": "downstream.placer.api:placer_train",
    },
)
