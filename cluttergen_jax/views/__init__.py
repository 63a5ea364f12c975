"""Views: what cameras see of scenes, by one maker, and the formats that write them."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.views.images import TENTH_OF_A_MILLIMETRE, depth_levels
    from cluttergen_jax.views.maker import ViewMaker

__getattr__, __all__ = offer(
    __name__,
    {
        "images": ("TENTH_OF_A_MILLIMETRE", "depth_levels"),
        "maker": ("ViewMaker",),
    },
)
