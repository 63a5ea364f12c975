"""Memory that compiled updates need, as their compiler reports it, and what there is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jax

from cluttergen_jax.errors import ConfigError


def check_memory(compiled: Any, limit: int | None = None) -> str:
    """A sentence on what a compiled program needs on each device and what there is.

    Simulations of the native engine come on top: they lie outside of the program.

    Args:
      compiled: from `jax.jit(...).lower(...).compile()`; its arguments lie in memory already.
      limit: bytes that it may need; None asks the device, or the host where the device is its processor.

    Raises:
      ConfigError: it will not fit.
    """
    sizes = compiled.memory_analysis()
    if sizes is None:
        return "not reported by this device"
    arguments = sizes.argument_size_in_bytes
    results = sizes.output_size_in_bytes - sizes.alias_size_in_bytes
    needed = arguments + results + sizes.temp_size_in_bytes
    limit = free_bytes() + arguments if limit is None else limit
    text = (
        f"{_amount(needed)}: state {_amount(arguments)} before and {_amount(results)} after an update, "
        f"{_amount(sizes.temp_size_in_bytes)} within it"
    )
    if needed > limit:
        raise ConfigError(
            f"a run that needs {text}",
            f"{_amount(limit)} of memory",
            "fewer environments (`num_envs`), a smaller network, or a higher `memory_limit` where one is set",
        )
    return f"{text} (of {_amount(limit)})"


def free_bytes() -> int:
    """Bytes that a run may take: of the accelerator, or of this machine (and its control group)."""
    stats = jax.local_devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return int(stats["bytes_limit"] - stats.get("bytes_in_use", 0))
    return min(_available(), _left_in_group())


def _available() -> int:
    """What the kernel says can be had without swapping; all there is, where it does not say."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _left_in_group() -> int:
    """What a container's limit leaves."""
    folder = Path("/sys/fs/cgroup")
    try:
        return int((folder / "memory.max").read_text()) - int((folder / "memory.current").read_text())
    except (OSError, ValueError):
        return 1 << 62


def _amount(num_bytes: float) -> str:
    return f"{num_bytes / 1e9:.1f} GB" if num_bytes >= 1e9 else f"{num_bytes / 1e6:.1f} MB"
