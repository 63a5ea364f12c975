"""Exports into one folder at once: each is whole where its caller was told that it is."""

import json

import pytest

from cluttergen_jax import kept_folder
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.exports import dining_scene


@pytest.fixture(scope="module")
def scene():
    return dining_scene()


def meanwhile(scene, act):
    """The scene, once something else has been done while its export is under way."""
    act()
    yield scene


def format_of(folder):
    return json.loads((folder / "MANIFEST.json").read_text())["export_format"]


@pytest.mark.parametrize("format", ["urdf", "mjcf"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_second_export_is_refused_while_one_is_written(scene, tmp_path, format, overwrite):
    out = tmp_path / "new"

    def refused():
        with pytest.raises(BankError, match=r"new is being written by process \d+ on"):
            export_scenes([scene], out, format, overwrite=overwrite)

    export_scenes(meanwhile(scene, refused), out, "mjcf")
    assert format_of(out) == "mjcf"
    assert [each.name for each in tmp_path.iterdir()] == ["new"]


def test_a_lock_is_let_go_of_when_an_export_fails(scene, tmp_path):
    def fails():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_scenes(meanwhile(scene, fails), tmp_path / "new")
    assert not list(tmp_path.iterdir())
    assert format_of(export_scenes([scene], tmp_path / "new", "urdf")) == "urdf"


def test_without_locks_the_slower_export_is_refused(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(kept_folder, "fcntl", None)
    out = tmp_path / "new"
    with pytest.raises(ConfigError, match="exists"):
        export_scenes(meanwhile(scene, lambda: export_scenes([scene], out, "urdf")), out, "mjcf")
    assert format_of(out) == "urdf"
