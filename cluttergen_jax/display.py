"""How scenes, banks and pools show themselves: they lie below what draws, and reach it by `display()`.

What draws imports them, so they cannot import it. `cluttergen_jax/__init__.py`, which is imported before any
of its modules, says who draws; nothing of that is loaded until something is shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

from cluttergen_jax.errors import ClutterGenError

if TYPE_CHECKING:
    from PIL import Image


class Display(Protocol):
    """What shows things; `options` are arguments of `cluttergen_jax.render` and `cluttergen_jax.view`."""

    def picture_of(self, scene: Any, options: Mapping[str, Any]) -> Image.Image:
        """One scene."""
        ...

    def sheet_of(self, source: Any, options: Mapping[str, Any]) -> Image.Image:
        """Scenes, of a bank or several values, on one contact sheet."""
        ...

    def pool_sheet_of(self, pool: Any, options: Mapping[str, Any]) -> Image.Image:
        """Objects of a pool on one contact sheet."""
        ...

    def show(self, source: Any, options: Mapping[str, Any]) -> Any:
        """A scene or a bank in the viewer; what `cluttergen_jax.view` returns."""
        ...

    def png_of(self, scene: Any) -> bytes | None:
        """A scene for a notebook; None, with a warning, where nothing can draw."""
        ...

    def html_of(self, bank: Any) -> str:
        """A bank for a notebook."""
        ...

    def pool_html_of(self, pool: Any) -> str:
        """A pool for a notebook."""
        ...


_drawn_by: Callable[[], Display] | None = None


def draw_with(find: Callable[[], Display]) -> None:
    """Says what draws from now on.

    Args:
      find: returns it, and is called when something is shown.
    """
    global _drawn_by
    _drawn_by = find


def display() -> Display:
    """What draws.

    Raises:
      ClutterGenError: nothing was named: the package was not imported as a whole.
    """
    if _drawn_by is None:
        raise ClutterGenError("nothing that draws is named", hint="import cluttergen_jax")
    return _drawn_by()
