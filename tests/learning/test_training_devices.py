"""Several devices and several processes make the run that one device makes, up to rounding."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training.run_logger import read_rows

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


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.mark.slow
def test_two_devices_train_like_one():
    finish(start("probe", devices=2))


@pytest.mark.slow
def test_two_devices_call_the_native_engine():
    finish(start("real", devices=2))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_processes_train_like_one_and_stop_and_go_on_together(tmp_path):
    folders = [tmp_path / name for name in ("first", "second", "alone")]
    for folder in folders:
        folder.mkdir()
    programs = tmp_path / "programs"
    # The second process asks to stop: both do, and what only the first one has stored is taken up by both.
    port = free_port()
    pair = [
        start("host", port, number, 2, folders[number], 1, programs=programs) for number in (0, 1)
    ]
    texts = [process.communicate()[0] for process in pair]
    assert all("KeyboardInterrupt" in text for text in texts), "\n\n".join(texts)
    assert 0 < read_record(folders[0] / "last")["num_updates"] < 4
    port = free_port()
    pair = [
        start("host", port, number, 2, folders[number], 0, programs=programs) for number in (0, 1)
    ]
    finish(*pair)
    finish(start("host", 0, 0, 1, folders[2], 0))
    assert sorted(path.name for path in folders[1].iterdir()) == ["weights-1.npy"]
    first, second, alone = (
        np.load(folder / name)
        for folder, name in zip(
            folders, ("weights-0.npy", "weights-1.npy", "weights-0.npy"), strict=True
        )
    )
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(first, alone, atol=1e-3)
    rows, rows_alone = (read_rows(folders[i] / "progress.csv") for i in (0, 2))
    assert [row["update"] for row in rows] == [0, 1, 2, 3]
    for row, other in zip(rows, rows_alone, strict=True):
        np.testing.assert_allclose(row["reward"], other["reward"], atol=1e-3)
