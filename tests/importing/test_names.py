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
def earlier_pool(monkeypatch):
    """A pool as an earlier version made it, told by the names and sources of its objects."""

    def make(sources):
        held = [Held(name=name, provenance=Held(source=source)) for name, source in sources.items()]
        monkeypatch.setattr("cluttergen_jax.importing.planning.read_pool", lambda _: Held(objects=held))

    return make


def test_a_pool_of_an_earlier_version_keeps_its_names(tmp_path, earlier_pool):
    folder = tmp_path / "set"
    save_box(folder / "mug" / "model_normalized.obj")
    save_box(folder / "杯.obj")
    save_box(folder / "碗.obj")
    new = planned(folder)
    assert {name for name, _ in new.values()} == {"mug", "bei", "wan"}
    assert planned(folder, tmp_path / "pools" / "none") == new
    place = f"{tmp_path.name}/set"
    earlier_pool({"model_normalized": "set/mug/model_normalized.obj", "object": f"{place}/杯.obj"})
    kept = planned(folder, tmp_path)
    assert kept["mug/model_normalized.obj"] == ("model_normalized", "model normalized")
    assert kept["杯.obj"] == ("object", "杯")
    # What the pool does not have is new.
    assert kept["碗.obj"] == ("wan", "碗")
    earlier_pool({"object": f"{place}/杯.obj", "object-2": f"{place}/碗.obj"})
    kept = planned(folder, tmp_path)
    assert [kept[name][0] for name in ("杯.obj", "碗.obj")] == ["object", "object-2"]
    # The same name from another file is another object.
    earlier_pool({"object": "elsewhere/杯.obj"})
    assert planned(folder, tmp_path) == new


@pytest.mark.slow
def test_an_import_again_renames_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    save_box(tmp_path / "杯.obj")
    config = ImportConfig(ObjectConfig(trials=8), jobs=1, progress=False)
    path = import_sources([tmp_path / "杯.obj"], "mine", config).path
    (asset,) = read_pool(path).objects
    assert (asset.name, asset.label) == ("bei", "杯")
    write_pool(
        path, Pool("mine", (replace(asset, name="object"),), licence=read_pool(path).licence), overwrite=True
    )
    before = read_pool(path).hash
    for add in (False, True):
        import_sources([tmp_path / "杯.obj"], "mine", replace(config, add=add))
        assert read_pool(path).names == ("object",)
        assert read_pool(path).hash == before
    import_sources([tmp_path / "杯.obj"], "mine", replace(config, force=True))
    assert read_pool(path).names == ("bei",)
