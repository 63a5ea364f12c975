"""Views: what cameras see of scenes, by one maker, and the formats that write them."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.views.images import TENTH_OF_A_MILLIMETRE, depth_levels, depth_of, png_of
    from cluttergen_jax.views.maker import ViewMaker
    from cluttergen_jax.views.view import View

__getattr__, __all__ = offer(
    __name__,
    {
        "images": ("TENTH_OF_A_MILLIMETRE", "depth_levels", "depth_of", "png_of"),
        "maker": ("ViewMaker",),
        "view": ("View",),
    },
)
