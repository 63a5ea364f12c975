"""What objects are called: after what says something, in Latin letters, and as the pool has them already."""

import pytest

from cluttergen_jax.importing.readers import find_sources
from cluttergen_jax.importing.readers.source import plain_name
from tests.helpers.shapes import save_box


def names(folder):
    return {source.name: source.label for source in find_sources(folder)}


@pytest.mark.parametrize(
    "path",
    [
        "model_normalized.obj",
        "textured.obj",
        "meshes/model.obj",
        "base_link.stl",
        "mesh.obj",
        "visual/base_link.obj",
    ],
)
def test_a_name_that_says_nothing_takes_the_folders(tmp_path, path):
    save_box(tmp_path / "blue_mug" / path)
    assert names(tmp_path) == {"blue_mug": "blue mug"}


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("杯子", "beizi"),
        ("чашка", "chashka"),
        ("Tasse_à_café", "tasse_a_cafe"),
        ("Teeku\u0308bel", "teekubel"),
        ("☕", "coffee"),
        ("Blue Mug (2)", "blue_mug_2"),
        ("mug-2", "mug-2"),
        ("...", "object"),
    ],
)
def test_other_scripts_and_accents_become_latin_letters(text, name):
    assert plain_name(text) == name
