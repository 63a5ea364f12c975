"""The list of tests that may be skipped names tests that are there."""

import ast
from pathlib import Path

import pytest

from tests.conftest import allowed_skips

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("node", sorted(allowed_skips()))
def test_what_may_be_skipped_exists(node):
    path, _, name = node.partition("::")
    tree = ast.parse((ROOT / path).read_text())
    assert name in {"", *(each.name for each in tree.body if isinstance(each, ast.FunctionDef))}
