"""What packages and modules offer: names of other modules, each imported when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

from cluttergen_jax.errors import closest


def offer(
    package: str, modules: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], list[str]]:
    """`__getattr__` and `__all__` of a package whose names cost nothing until they are used.

    Args:
      package: its `__name__`.
      modules: names to offer, by the module of the package that has them.
    """
    homes = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return find, sorted(homes)


def name_space(
    module: str, homes: Mapping[str, str], former: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a module that shows, under names of its own, what others define.

    Args:
      module: its `__name__`.
      homes: where each name is defined, as MODULE:NAME within `cluttergen_jax`, or MODULE for all of one.
      former: names that are not shown any more and go on working, likewise.
    """
    known = {**homes, **(former or {})}

    def find(name: str) -> Any:
        if name not in known:
            meant = closest(name, homes)
            hint = f". Did you mean {meant!r}?" if meant else ""
            raise AttributeError(f"module {module!r} has no attribute {name!r}{hint}")
        home, _, there = known[name].partition(":")
        found = import_module(f"cluttergen_jax.{home}")
        return getattr(found, there) if there else found

    return find, lambda: sorted(homes)
