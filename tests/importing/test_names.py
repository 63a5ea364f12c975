"""What objects are called: after what says something, in Latin letters, and as the pool has them already."""

import re
from dataclasses import replace
from types import SimpleNamespace as Held

import pytest
import trimesh

from cluttergen_jax.assets.pool import Pool, read_pool, write_pool
from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, find_sources
from cluttergen_jax.importing.readers.source import plain_name
from cluttergen_jax.importing.run import ImportConfig, ObjectConfig, import_sources


def save_box(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((0.05, 0.05, 0.05)).export(path)


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


def test_a_body_whose_name_says_nothing_takes_the_files(tmp_path):
    body = '<body name="{}"><geom type="box" size=".02 .02 .02"/></body>'
    bodies = "".join(map(body.format, ("base_link", "lid", "object")))
    (tmp_path / "pot.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert names(tmp_path) == {"pot": "pot", "lid": "lid", "pot-2": "pot"}


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


def test_long_names_fit_a_folder():
    assert re.fullmatch("[a-z0-9_-]{1,200}", plain_name("杯" * 80))


def test_labels_keep_the_script(tmp_path):
    for name in ("杯子", "茶壶", "café"):
        save_box(tmp_path / f"{name}.obj")
    assert names(tmp_path) == {"cafe": "café", "beizi": "杯子", "chahu": "茶壶"}


def planned(folder, pool=None):
    objects = plan_all([folder], ReadOptions(), pool=pool).objects
    return {
        each.source.path.relative_to(folder).as_posix(): (each.source.name, each.source.label)
        for each in objects
    }


@pytest.fixture
def pool_with(monkeypatch):
    """A pool, given by the names and sources of its objects."""

    def make(sources):
        held = [Held(name=name, provenance=Held(source=source)) for name, source in sources.items()]
        monkeypatch.setattr("cluttergen_jax.importing.planning.read_pool", lambda _: Held(objects=held))

    return make


def test_what_a_pool_has_keeps_its_names(tmp_path, pool_with):
    folder = tmp_path / "set"
    save_box(folder / "a" / "mug.obj")
    save_box(folder / "b" / "mug.obj")
    new = planned(folder)
    assert [name for name, _ in new.values()] == ["mug", "mug-2"]
    assert planned(folder, tmp_path / "pools" / "none") == new
    pool_with({"mug": "set/b/mug.obj", "mug-7": "set/a/mug.obj"})
    assert {path: name for path, (name, _) in planned(folder, tmp_path).items()} == {
        "a/mug.obj": "mug-7",
        "b/mug.obj": "mug",
    }
    # What the pool does not have is new, and the same name from another file is another object.
    pool_with({"mug-7": "set/a/mug.obj", "mug": "elsewhere/mug.obj"})
    assert [name for name, _ in planned(folder, tmp_path).values()] == ["mug-7", "mug"]


@pytest.mark.slow
def test_an_import_again_renames_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    save_box(tmp_path / "杯.obj")
    config = ImportConfig(ObjectConfig(trials=8), jobs=1, progress=False)
    path = import_sources([tmp_path / "杯.obj"], "mine", config).path
    (asset,) = read_pool(path).objects
    assert (asset.name, asset.label) == ("bei", "杯")
    write_pool(
        path, Pool("mine", (replace(asset, name="bei-2"),), licence=read_pool(path).licence), overwrite=True
    )
    before = read_pool(path).hash
    for add in (False, True):
        import_sources([tmp_path / "杯.obj"], "mine", replace(config, add=add))
        assert read_pool(path).names == ("bei-2",)
        assert read_pool(path).hash == before
    import_sources([tmp_path / "杯.obj"], "mine", replace(config, force=True))
    assert read_pool(path).names == ("bei",)
