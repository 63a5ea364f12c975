"""Environments of other programs, made afresh from the package index."""

from __future__ import annotations

import json
import os
import subprocess
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

PEERS = Path(__file__).parents[1] / "peers"


def peer_python(peer: str, folder: Path, *packages: str, alone: Sequence[str] = ()) -> str:
    """The interpreter that CLUTTERGEN_PEER_PYTHON names, or that of a new environment with these packages."""
    return os.environ.get(f"CLUTTERGEN_{peer.upper()}_PYTHON") or str(
        python_with(folder, *packages, alone=alone)
    )


def named_python(peer: str) -> str:
    """The interpreter that CLUTTERGEN_PEER_PYTHON names, of an environment too large to make for a test."""
    python = os.environ.get(f"CLUTTERGEN_{peer.upper()}_PYTHON")
    if not python:
        pytest.skip(
            f"CLUTTERGEN_{peer.upper()}_PYTHON names no interpreter that has {peer} and pyarrow"
        )
    return python


def ask_peer(peer: str, python: str, *words: object, seconds: float = 280) -> dict[str, Any]:
    """What the script of a peer prints last: JSON, in which every number must be finite."""
    command = [python, str(PEERS / f"read_in_{peer}.py"), *map(str, words)]
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    ran = subprocess.run(
        command, capture_output=True, text=True, env=environment, check=False, timeout=seconds
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    return json.loads(ran.stdout.splitlines()[-1], parse_constant=_refuse)


def _refuse(constant: str) -> None:
    raise AssertionError(f"a number that is told is {constant}")


def python_with(folder: Path, *packages: str, alone: Sequence[str] = ()) -> Path:
    """The Python of a new environment with these packages, and `alone` without what they need."""
    venv.create(folder, with_pip=True)
    for words in (packages, ("--no-deps", *alone)) if alone else (packages,):
        subprocess.run([folder / "bin/pip", "install", "--quiet", *words], check=True, timeout=1000)
    return folder / "bin/python"
