"""Banks and policies to and from a hub (extra `hub`), as `cluttergen push` and `cluttergen pull`."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.api.export import pull_bank, pull_policies, push_bank

__all__ = ["pull_bank", "pull_policies", "push_bank"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "pull_bank": "api.export:pull_bank",
        "pull_policies": "api.export:pull_policies",
        "push_bank": "api.export:push_bank",
    },
)
