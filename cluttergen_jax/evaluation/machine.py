"""Provenance of a table: versions, the day, and the machine on which speeds depend."""

from __future__ import annotations

import datetime
import json
import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

import jax

from cluttergen_jax.evaluation.records import Machine, Origin, Row

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


def origin() -> Origin:
    """When and where something is made: `date` and `machine` of now and here."""
    return {"date": datetime.datetime.now(datetime.UTC).date().isoformat(), "machine": machine()}


def origins_of(made: Iterable[Row]) -> list[Origin]:
    """When and where several things were made: an entry for each machine, the latest first.

    Args:
      made: things with what `origin` said of them; those that older versions kept lack it.

    Returns:
      `date`, a day or "FIRST to LAST", and `machine`; both None, and last, for things that lack them.
    """
    machines: dict[str, Machine] = {}
    days: dict[str, list[str]] = {}
    unknown: list[Origin] = []
    for each in made:
        if "machine" in each:
            name = json.dumps(each["machine"], sort_keys=True)
            machines.setdefault(name, each["machine"])
            days.setdefault(name, []).append(each["date"])
        else:
            unknown = [{"date": None, "machine": None}]
    latest_first = sorted(days, key=lambda name: max(days[name]), reverse=True)
    spans = {
        name: " to ".join(dict.fromkeys((min(days[name]), max(days[name]))))
        for name in latest_first
    }
    return [Origin(date=span, machine=machines[name]) for name, span in spans.items()] + unknown


def sentence(facts: Machine) -> str:
    """A machine for people."""
    parts = [f"{facts['cores']} {'core' if facts['cores'] == 1 else 'cores'} of {facts['cpu']}"]
    parts += [facts["accelerator"]] if facts["accelerator"] else []
    parts += [
        f"Python {facts['python']}",
        *(f"{name} {v}" for name, v in facts["versions"].items()),
    ]
    return ", ".join(parts)


def cpu_model() -> str:
    """The processor's name, or as much as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
