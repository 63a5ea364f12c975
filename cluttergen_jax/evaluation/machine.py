"""Provenance of a table: versions, and the machine on which speeds depend."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

_PACKAGES = ("cluttergen_jax", "mujoco", "mujoco-mjx", "jax")


def versions() -> dict[str, str]:
    """Versions that results depend on."""
    return {name: version(name) for name in _PACKAGES}


def machine() -> dict[str, Any]:
    """Cores, model of the processor, accelerator, and versions."""
    devices = jax.devices()
    return {
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "cpu": cpu_model(),
        "accelerator": devices[0].device_kind if devices[0].platform != "cpu" else None,
        "python": platform.python_version(),
        "versions": versions(),
    }


def sentence(facts: dict[str, Any]) -> str:
    """The same for people."""
    parts = [f"{facts['cores']} {'core' if facts['cores'] == 1 else 'cores'} of {facts['cpu']}"]
    parts += [facts["accelerator"]] if facts["accelerator"] else []
    parts += [f"Python {facts['python']}", *(f"{name} {v}" for name, v in facts["versions"].items())]
    return ", ".join(parts)


def cpu_model() -> str:
    """The processor's name, or as much as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
