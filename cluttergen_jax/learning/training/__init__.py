"""Runs of the learner: progress, records, checkpoints, and resuming them."""

from cluttergen_jax.learning.training.interrupt import Interrupt
from cluttergen_jax.learning.training.metrics_log import MetricsLog

__all__ = ["Interrupt", "MetricsLog"]
