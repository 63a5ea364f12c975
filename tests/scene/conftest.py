"""The made-up bank of most tests of banks, and the scene of most tests of exports."""

import shutil
from pathlib import Path

import pytest

from tests.helpers import banks
from tests.helpers.exports import dining_scene, exporter


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


@pytest.fixture(scope="module")
def scene():
    """Four objects on a table; a module may have another one."""
    return dining_scene()


@pytest.fixture(scope="module")
def folder_of(scene, tmp_path_factory):
    """From a format to the folder of `scene` in it."""
    return exporter(scene, tmp_path_factory)
