"""Where source code makes errors."""

from __future__ import annotations

import ast
from collections.abc import Iterator


def error_calls(tree: ast.AST) -> Iterator[ast.Call]:
    """Calls in a tree of source code of what is called ...Error."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            # The last name alone: to write out every call takes seconds.
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if name.endswith("Error"):
                yield node
