"""What evaluation stores as JSON: rows and findings; when, where and by which code they were made."""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import Any, TypedDict

import jax

Share = Mapping[str, float | None]
"""`share`, or `success`, with its 95 % interval, `low95` and `high95` (`statistics.proportion`)."""
Spread = Mapping[str, Any]
"""`statistics.spread_of`."""


class Machine(TypedDict):
    """What speeds depend on."""

    cores: int | None
    cpu: str
    accelerator: str | None
    python: str
    versions: dict[str, str]


class RunInfo(TypedDict, total=False):
    """When, where and by which code something was made; None where an older version did not note it."""

    date: str | None
    machine: Machine | None
    commit: str | None


class Figures(TypedDict, total=False):
    """What became of a trial's episodes (`runner.figures_of`); `paper` by the paper's looser count."""

    trials: int
    num_success: int
    success: float
    low95: float
    high95: float
    filled: float
    placed: float
    placed_histogram: list[int]
    attempts: int
    within: list[Share]
    attempts_per_valid_scene: float | None
    attempts_histogram: list[int]
    simulated_steps: int
    simulated_steps_per_valid_scene: float | None
    stack: Spread
    stable_steps: Spread
    rest_steps: Spread
    steps_by_attempt: list[Spread]
    verdicts: dict[str, int]
    num_crept: int
    seconds: float
    cpu_seconds: float
    compile_seconds: float
    valid_scenes_per_second: float
    valid_scenes_per_cpu_second: float | None
    fill: float
    # Of the pairs in which one thing carries another, by the table of sense; None where there are none.
    usual_pairs: float | None
    num_pairs: int
    # Pairs of objects that touch from the side, for each object.
    side_contacts: float | None
    paper: Figures


class Row(TypedDict, total=False):
    """A row of a trial, with `trial`, or of findings; one that could not be made has `missing` and `hint`."""

    trial: Mapping[str, Any]
    sources: Mapping[str, Any]
    policy: Mapping[str, Any] | None
    rules: Mapping[str, Any]
    first: Mapping[str, list[int]]
    figures: Figures
    date: str
    machine: Machine
    commit: str | None
    missing: str
    hint: str
    # Of findings: what the trial asked, and what was found.
    pool: str
    support: str
    method: str
    min_margin: float
    scenes: int
    share: float
    low95: float
    high95: float
    success: float | None
    # Robustness and survival.
    creep: list[Share]
    shake: list[float]
    changes: dict[str, Share]
    margin: list[float]
    below: float
    unsupported: float
    tilt: list[Share]
    objects: int
    robust: Share
    survival: dict[str, Share]
    engine: str
    seconds: float
    median_shift: float | None
    # Diversity, acceptance, relations.
    object: str
    evenness: float | None
    nearest: float | None
    vendi: float | None
    box_area: float | None
    edges: float | None
    clusters: float | None
    heaped: float | None
    sorting: str
    under: list[Row]
    label: str
    lift: float
    proposals: int
    passed: int
    relation: str
    count: int
    scenes_with: int
    commonest: list[Mapping[str, Any]]
    # Clutter targets.
    target: float | None
    # Time and training.
    cores: int
    valid: int
    seconds_per_valid_scene: float | None
    running_seconds_per_valid_scene: float | None
    seed: int
    attempts: int
    checked: float | None


_PACKAGES = ("cluttergen_jax", "mujoco", "mujoco-mjx", "jax")


def versions() -> dict[str, str]:
    """Versions that results depend on."""
    return {name: version(name) for name in _PACKAGES}


def machine() -> Machine:
    """Cores, model of the processor, accelerator, and versions."""
    devices = jax.devices()
    return {
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "cpu": cpu_model(),
        "accelerator": devices[0].device_kind if devices[0].platform != "cpu" else None,
        "python": platform.python_version(),
        "versions": versions(),
    }


def origin() -> RunInfo:
    """When, where and by which code something is made: `date`, `machine` and `commit` of now and here."""
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": machine(),
        "commit": commit_of_here(),
    }


CODE = ("cluttergen_jax", "scenes", "studies", "pyproject.toml", "constraints.txt")
"""Folders and files of the repository that decide results."""
CHANGED = "+changes"
"""After a commit: files of `CODE` differ from it."""


@cache
def commit_of_here() -> str | None:
    """The commit of the code that runs, 12 hex digits, with `CHANGED` after it; None where nobody knows.

    It is that of the repository around the package, or the one that was installed.
    """
    root = Path(__file__).parents[2]
    if (root / ".git").exists():
        commit = _git(root, "rev-parse", "--short=12", "HEAD")
        if commit is None:
            return None
        return commit + (CHANGED if _git(root, "status", "--porcelain", "--", *CODE) else "")
    try:
        told = distribution("cluttergen_jax").read_text("direct_url.json")
    except PackageNotFoundError:
        told = None
    commit = json.loads(told or "{}").get("vcs_info", {}).get("commit_id")
    return commit[:12] if commit else None


def _git(root: Path, *words: str) -> str | None:
    """What git says; None where it is not there, or fails."""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *words], capture_output=True, text=True, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def cpu_model() -> str:
    """The processor's name, or as much as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
