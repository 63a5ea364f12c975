"""Several devices and several processes make the run that one device makes, up to rounding."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def start(*arguments, devices=1, programs=""):
    """A process that sees so many devices; it looks for compiled programs in a folder, if there is one."""
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    environment |= {"JAX_COMPILATION_CACHE_DIR": str(programs)} if programs else {}
    return subprocess.Popen(
        [sys.executable, "-m", "tests.helpers.devices", *map(str, arguments)],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def finish(*processes) -> list[str]:
    texts = [process.communicate()[0] for process in processes]
    assert all(process.returncode == 0 for process in processes), "\n\n".join(texts)
    return texts


@pytest.mark.slow
def test_two_devices_train_like_one():
    finish(start("probe", devices=2))


@pytest.mark.slow
def test_two_devices_call_the_native_engine():
    finish(start("real", devices=2))
