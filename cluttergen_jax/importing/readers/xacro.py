"""Xacro: URDF with macros, which are to be expanded before it can be read."""

from __future__ import annotations

import re
from pathlib import Path

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.xml_tree import Element

SUFFIX = ".xacro"
_ELEMENT = re.compile(rb"<(xacro:\w+)")
_EXPRESSION = re.compile(r"\$\{.*?\}|\$\(.*?\)")
_NAMESPACE = re.compile(r"\{.*xacro\}")


def refuse_xacro(path: Path, robot: Element | None = None) -> None:
    """Refuses an unprocessed xacro; without its root, by the text of a file that cannot be parsed.

    Raises:
      AssetError: it says how to process it.
    """
    sign = _sign_in_text(path) if robot is None else _sign_in_tree(robot)
    if sign:
        raise AssetError(f"{path} is an unprocessed xacro: it has {sign}", "URDF", how_to_process(path))


def how_to_process(path: Path) -> str:
    """The command that makes URDF of a xacro."""
    stem = path.name.removesuffix(SUFFIX).removesuffix(".urdf")
    return f"xacro {path.name} > {stem if path.suffix == SUFFIX else stem + '_plain'}.urdf"


def _sign_in_text(path: Path) -> str:
    try:
        found = _ELEMENT.search(path.read_bytes())
    except OSError:
        return ""
    return f"<{found[1].decode(errors='replace')}>" if found else ""


def _sign_in_tree(robot: Element) -> str:
    """The first thing that a processed file has no more; empty where there is none."""
    for element in robot.iter():
        if isinstance(element.tag, str) and (found := _NAMESPACE.match(element.tag)):
            return f"<xacro:{element.tag[found.end() :]}>"
        for name, value in element.items():
            if _EXPRESSION.search(value):
                return f'{name}="{value}"'
    return ""
