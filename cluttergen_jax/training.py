"""Training beside `train`: all policies of a suite, and encoders before them."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.api.train import pretrain, train_suite

__all__ = ["pretrain", "train_suite"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "pretrain": "api.train:pretrain",
        "train_suite": "api.train:train_suite",
    },
)
