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
    from cluttergen_jax.learning.policies.embedded import checkpoints_in
    from cluttergen_jax.learning.ppo.checkpoint import (
        read_policy,
        read_record,
        save_policy,
    )
    from cluttergen_jax.learning.training.guided import (
        Calibration,
        calibration,
        draw_calibration,
    )
    from cluttergen_jax.learning.training.run_folder import (
        RunFolder,
        batch_of,
        hold_run,
        versions,
    )
    from cluttergen_jax.learning.training.run_logger import MetricsLog

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
        "policies.embedded": ("checkpoints_in",),
        "ppo.checkpoint": (
            "read_policy",
            "read_record",
            "save_policy",
        ),
        "training.run_logger": ("MetricsLog",),
        "training.run_folder": (
            "RunFolder",
            "batch_of",
            "hold_run",
            "versions",
        ),
        "training.guided": ("Calibration", "calibration", "draw_calibration"),
    },
)
