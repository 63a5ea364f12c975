"""`docs/results.md`: every number in it comes from the JSON files beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.report import markdown
from cluttergen_jax.evaluation.store import FORMAT
from cluttergen_jax.evaluation.suites import FORMER_NAMES, STUDIES, SUITES

_HEADINGS = {"paper": "The paper's tables and figures", "extended": "What the paper does not ask"}
_INTRODUCTION = """# Results

Every number here was written by `python docs/make_results.py` from the JSON files in `docs/results`; a test
checks that the two agree. Each section names the command that made it, its trials and its machine. What
success means: *strict* is this project's `is_success` (nothing else is disturbed, and the finished scene
stands); *the paper's count* judges only the current object and puts the others back.
"""


def read_results(folder: Path) -> list[dict[str, Any]]:
    """The studies in a folder, in the order of their suites.

    Raises:
      ConfigError: a file is damaged, or is no study's result.
    """
    results = []
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a folder", "one that `cluttergen evaluate --suite` made")
    for path in sorted(folder.glob("*.json")):
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"{path} cannot be read ({getattr(error, 'strerror', None) or error})", hint="making it again"
            ) from error
        if not isinstance(result, dict) or result.get("format") != FORMAT or "suite" not in result:
            raise ConfigError(f"{path} is not the result of a study of format {FORMAT}", hint="removing it")
        results.append(result)
    order = list(STUDIES)
    known = [result for result in results if result["name"] in order]
    return sorted(known, key=lambda result: order.index(result["name"]))


def suite_of(result: dict[str, Any]) -> str:
    """The suite of a result, by its name of today."""
    return FORMER_NAMES.get(result["suite"], result["suite"])


def document(results: list[dict[str, Any]], notes: str = "", link: str = "results/") -> str:
    """The whole page; `notes`, Markdown, stand at its end."""
    parts = [_INTRODUCTION]
    for suite in SUITES:
        of_suite = [result for result in results if suite_of(result) == suite]
        if of_suite:
            parts += [f"## {_HEADINGS[suite]}\n", *(markdown(result, 3, link) for result in of_suite)]
    return "\n".join([*parts, notes] if notes else parts)
