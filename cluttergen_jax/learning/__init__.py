"""Learning to place: networks, PPO, agents and their policies, training runs."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.learning.methods import (
        checkpoint_of,
        choose_method,
        proposer_of,
        sampler_of,
        with_history_of,
    )
    from cluttergen_jax.learning.ppo.checkpoint import (
        check_folder,
        has_state,
        hold_run,
        read_policy,
        read_record,
        read_state,
        save_policy,
        save_state,
    )
    from cluttergen_jax.learning.training.interrupt import Interrupt
    from cluttergen_jax.learning.training.metrics_log import MetricsLog
    from cluttergen_jax.learning.training.stability import (
        Calibration,
        calibration,
        draw_calibration,
    )

__getattr__, __all__ = offer(
    __name__,
    {
        "methods": (
            "checkpoint_of",
            "choose_method",
            "proposer_of",
            "sampler_of",
            "with_history_of",
        ),
        "ppo.checkpoint": (
            "check_folder",
            "has_state",
            "hold_run",
            "read_policy",
            "read_record",
            "read_state",
            "save_policy",
            "save_state",
        ),
        "training.interrupt": ("Interrupt",),
        "training.metrics_log": ("MetricsLog",),
        "training.stability": ("Calibration", "calibration", "draw_calibration"),
    },
)
