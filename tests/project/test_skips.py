"""A test may be skipped for want of an extra or a program, and for nothing else."""

import re
import tomllib
from pathlib import Path

import pytest

from tests.conftest import is_allowed

ROOT = Path(__file__).parents[2]


def reasons() -> set[str]:
    """What tests say where they import something that may be missing."""
    found = set()
    for path in (ROOT / "tests").rglob("*.py"):
        calls = path.read_text().split("importorskip(")[1:]
        found |= {
            (re.search(r'reason="([^"]*)"', call.split("\n")[0]) or ["", path.name])[1]
            for call in calls
        }
    return found - {Path(__file__).name}


def test_whatever_needs_an_extra_names_one_that_exists():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    assert reasons() <= {f"needs the extra {name}" for name in extras}


def test_what_is_not_installed_by_make_test_may_be_missing_and_the_rest_may_not():
    install = re.search(r"/\.dev: .*\n.*-e '\.\[(.*)\]'", (ROOT / "Makefile").read_text())
    assert install is not None
    # Warp comes with `dev`.
    installed = {*install[1].split(","), "gpu"}
    for reason in reasons():
        assert is_allowed(reason) == (reason.split()[-1] not in installed), reason


@pytest.mark.parametrize(
    "reason",
    ["could not import 'jax': No module named 'jax'", "", "flaky", "not needs the extra peers"],
)
def test_other_reasons_are_none(reason):
    assert not is_allowed(reason)
