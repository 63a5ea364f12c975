"""The physics engines and their interface (`host.Physics`)."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.physics.engines import engine_of, make_physics, step_seconds
    from cluttergen_jax.physics.mjx_pairs import faces_first, soften_contacts
    from cluttergen_jax.physics.paper_count import PaperCount
    from cluttergen_jax.physics.stability import Verdict
    from cluttergen_jax.physics.standing import check_standing, displacement, has_moved, watch

__getattr__, __all__ = offer(
    __name__,
    {
        "engines": ("engine_of", "make_physics", "step_seconds"),
        "mjx_pairs": ("faces_first", "soften_contacts"),
        "paper_count": ("PaperCount",),
        "stability": ("Verdict",),
        "standing": ("check_standing", "displacement", "has_moved", "watch"),
    },
)
