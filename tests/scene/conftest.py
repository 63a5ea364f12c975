"""The made-up bank of most tests of banks."""

import shutil
from pathlib import Path

import pytest

from tests.helpers import banks


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A bank with all its files, as it was written; a module may have another one."""
    path = tmp_path_factory.mktemp("banks") / "bank"
    banks.with_files(path)
    return path


@pytest.fixture
def bank(whole, tmp_path):
    """A copy of `whole` that a test may harm."""
    return Path(shutil.copytree(whole, tmp_path / "bank"))
