"""Environments of other programs, made afresh from the package index."""

from __future__ import annotations

import subprocess
import venv
from pathlib import Path


def python_with(folder: Path, *packages: str) -> Path:
    """The Python of a new environment in `folder` that has these packages."""
    venv.create(folder, with_pip=True)
    words = [folder / "bin/pip", "install", "--quiet", *packages]
    subprocess.run(words, check=True, timeout=400)
    return folder / "bin/python"
