"""What a glTF file says of its object in words: where it ends up, and what goes before it."""

from dataclasses import replace

import pytest

from cluttergen_jax.assets.facts import ObjectFacts, parse_condition
from cluttergen_jax.assets.object_files import object_hash, read_object, write_object
from cluttergen_jax.importing.planning import plan_all
from cluttergen_jax.importing.readers import ReadOptions, read_shape
from cluttergen_jax.importing.readers.gltf import words_of
from tests.helpers.gltf import Gltf
from tests.helpers.shapes import make_box

SKETCHFAB = {
    "author": "Ann (https://example.org/ann)",
    "license": "CC-BY-4.0",
    "source": "https://example.org/1",
    "title": "Tea cup",
}


def gltf(path, **holders):
    made = Gltf()
    for name, extras in holders.items():
        holder = made.document["asset"] if name == "asset" else made.document[name][0]
        holder["extras"] = extras
    return made.write(path)


@pytest.mark.parametrize("holder", ["asset", "scenes", "nodes", "meshes"])
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_words_are_found_where_they_stand(tmp_path, holder, suffix):
    path = gltf(
        tmp_path / f"thing.{suffix}", **{holder: {"Label": " tea  cup ", "synset": "cup.n.01"}}
    )
    assert words_of(path) == {"label": "tea cup", "synset": "cup.n.01"}


def test_the_file_goes_before_its_mesh_and_of_several_meshes_none_counts(tmp_path):
    path = gltf(
        tmp_path / "a.glb", asset={"title": "cup"}, meshes={"label": "handle", "category": "mug"}
    )
    assert words_of(path) == {"label": "cup", "synset": "mug"}
    several = Gltf()
    several.document["meshes"] *= 2
    several.document["meshes"][0]["extras"] = {"label": "handle"}
    assert words_of(several.write(tmp_path / "b.glb")) == {}


@pytest.mark.parametrize(
    "extras", [None, [], "text", {"label": 3, "synset": "", "licence": None}, {"name": " "}]
)
def test_other_extras_say_nothing(tmp_path, extras):
    assert words_of(gltf(tmp_path / "a.glb", asset=extras)) == {}


def test_terms_and_label_of_a_downloaded_file(tmp_path):
    gltf(tmp_path / "1a2b3c.glb", asset=SKETCHFAB)
    (plan,) = plan_all([tmp_path], ReadOptions()).objects
    shape = read_shape(plan.source, plan.options)
    assert shape.label == "Tea cup"
    assert shape.provenance.licence == "CC-BY-4.0"
    assert shape.provenance.attribution == "Ann (https://example.org/ann), https://example.org/1"
    assert shape.is_pose_free


def test_settings_and_options_go_before_the_file(tmp_path):
    gltf(tmp_path / "a.glb", asset=SKETCHFAB | {"synset": "cup.n.01"})
    (tmp_path / "labels.csv").write_text("file,label,synset,licence\na.glb,mug,mug.n.04,\n")
    (plan,) = plan_all([tmp_path], ReadOptions(licence="CC0"), tmp_path / "labels.csv").objects
    shape = read_shape(plan.source, plan.options)
    assert (shape.label, shape.synset, shape.provenance.licence) == ("mug", "mug.n.04", "CC0")


def test_what_says_nothing_is_no_label(tmp_path):
    gltf(tmp_path / "tea_cup.glb", meshes={"name": "geometry_0"})
    (plan,) = plan_all([tmp_path], ReadOptions()).objects
    assert plan.source.label == "tea cup"


def test_a_synset_is_kept_and_chosen_by(tmp_path):
    plain = make_box()
    asset = replace(plain, synset="mug.n.04")
    write_object(tmp_path / "a", asset)
    again = read_object(tmp_path / "a")
    assert again.synset == "mug.n.04"
    assert object_hash(again) == object_hash(asset) != object_hash(plain)
    is_mug = parse_condition("synset=mug*")
    assert is_mug(ObjectFacts.of(again))
    assert not is_mug(ObjectFacts.of(plain))
