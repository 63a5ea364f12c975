"""Layouts, what shall stand where, as `cluttergen layout`: read, checked, asked of a language model."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.api.layout import ask_layout as ask
    from cluttergen_jax.api.layout import check_layout as check
    from cluttergen_jax.generation.layout_check import layout_schema as schema
    from cluttergen_jax.generation.layouts import list_layouts
    from cluttergen_jax.generation.layouts import read_layout as read

__all__ = ["ask", "check", "list_layouts", "read", "schema"]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "ask": "api.layout:ask_layout",
        "check": "api.layout:check_layout",
        "list_layouts": "generation.layouts:list_layouts",
        "read": "generation.layouts:read_layout",
        "schema": "generation.layout_check:layout_schema",
    },
)
