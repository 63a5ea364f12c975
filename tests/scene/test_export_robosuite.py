"""robosuite takes what follows a folder called `robosuite` in a path for files of its own."""

import runpy
import shutil

import pytest

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.export import export_scenes


@pytest.mark.parametrize("format", ["robosuite", "libero", "robocasa"])
def test_an_export_is_refused_where_robosuite_would_rewrite_its_path(format, scene, tmp_path):
    for place in (tmp_path / "robosuite", tmp_path / "robosuite" / "scenes" / "out"):
        with pytest.raises(ConfigError, match="called 'robosuite'"):
            export_scenes([scene], place, format)
    assert not list(tmp_path.iterdir())


def test_other_formats_and_other_names_are_written(scene, tmp_path):
    for place, format in (
        (tmp_path / "robosuite" / "out", "mjcf"),
        (tmp_path / "in_robosuite", "robosuite"),
    ):
        assert (export_scenes([scene], place, format) / "scenes").is_dir()


def test_an_export_that_was_moved_into_such_a_folder_says_so(folder_of, tmp_path, monkeypatch):
    moved = shutil.copytree(folder_of("robocasa"), tmp_path / "robosuite" / "out")
    monkeypatch.syspath_prepend(moved)
    with pytest.raises(ValueError, match="called 'robosuite'"):
        runpy.run_path(str(moved / "cluttergen_robocasa.py"))
