"""Datasets of views in the libraries that people read them with: `datasets`, WebDataset."""

import io
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.views import shards
from tests.helpers.placing import write_bank

ASKED = {"cameras": ("free:2",), "size": (64, 48), "colour": False, "splits": "train=0.6,val=0.4"}


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return write_bank(tmp_path_factory.mktemp("bank") / "bank", 5)


@pytest.fixture(scope="module")
def views(bank, tmp_path_factory):
    return cg.make_dataset(bank.path, tmp_path_factory.mktemp("sets") / "views", **ASKED)


@pytest.fixture(scope="module")
def rows(views):
    files = sorted(views.path.glob("train-*.parquet"))
    return [row for file in files for row in pq.read_table(file).to_pylist()]


def front_matter(folder):
    _, text, _ = (folder / "README.md").read_text().split("---\n", 2)
    return yaml.safe_load(text)


def arrow_of(feature):
    """The type that a column has to have for its feature to count, by the library's public rules."""
    if feature["_type"] == "Image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    if feature["_type"] == "Value":
        return pa.type_for_alias(feature["dtype"])
    assert feature["_type"] == "Sequence"
    return pa.list_(arrow_of(feature["feature"]), feature.get("length", -1))


def test_the_schema_says_of_each_column_what_it_is(views):
    for file in views.path.glob("*.parquet"):
        schema = pq.read_schema(file)
        features = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
        assert list(features) == schema.names
        assert {field.name: field.type for field in schema} == {
            name: arrow_of(feature) for name, feature in features.items()
        }
        images = [name for name, feature in features.items() if feature["_type"] == "Image"]
        assert images == ["rgb", "depth", "label"]
        assert features["amodal"]["feature"]["_type"] == "Image"


def test_the_card_tells_licence_features_and_splits(bank, views):
    told = front_matter(views.path)
    assert told["license"] == "apache-2.0"
    assert told["configs"] == [
        {
            "config_name": "default",
            "data_files": [
                {"split": split, "path": f"{split}-[0-9]*.parquet"} for split in ("train", "val")
            ],
        }
    ]
    info = told["dataset_info"]
    assert {each["name"]: each["num_examples"] for each in info["splits"]} == views.num_views
    size = sum(each.stat().st_size for each in views.path.glob("*.parquet"))
    assert info["dataset_size"] == sum(each["num_bytes"] for each in info["splits"]) == size
    assert [each["name"] for each in info["features"]] == shards.SCHEMA.names
    text = (views.path / "README.md").read_text()
    assert all(f"(`{name}`)" in text for name in bank.assets["objects"])


def test_a_card_of_the_users_own_stays(bank, tmp_path):
    out = tmp_path / "views"
    cg.make_dataset(bank.path, out, **ASKED)
    (out / "README.md").write_text("mine")
    cg.make_dataset(bank.path, out, **ASKED)
    assert (out / "README.md").read_text() == "mine"


def test_shards_of_before_images_were_images_are_made_again(bank, views, tmp_path):
    out = tmp_path / "views"
    cg.make_dataset(bank.path, out, **ASKED)
    file = min(out.glob("train-*.parquet"))
    whole = file.read_bytes()
    table = pq.read_table(file)
    plain = [each["bytes"] for each in table["depth"].to_pylist()]
    place = table.schema.get_field_index("depth")
    old = table.set_column(place, "depth", pa.array(plain, pa.binary()))
    pq.write_table(old.replace_schema_metadata(None), file)
    # As of a maker that was stopped before it told of the digest.
    record = shards.VIEWS.read_record(out)
    record["shards"].pop(file.name)
    shards.VIEWS.write_record(out, record)
    cg.make_dataset(bank.path, out, **ASKED)
    assert file.read_bytes() == whole


def test_datasets_gives_images(views, rows, tmp_path):
    datasets = pytest.importorskip("datasets", reason="needs the extra readers")
    # The folder as a hub has it: by its card.
    found = datasets.load_dataset(str(views.path), cache_dir=str(tmp_path))
    assert {split: len(each) for split, each in found.items()} == views.num_views
    image = datasets.Image()
    features = found["train"].features
    assert [features[name] for name in ("rgb", "depth", "label")] == [image] * 3
    assert features["amodal"] == datasets.List(image)
    told = datasets.Features._from_yaml_list(front_matter(views.path)["dataset_info"]["features"])
    assert told == features
    for view, row in zip(found["train"], rows, strict=True):
        assert view["rgb"] is None
        own = np.asarray(Image.open(io.BytesIO(row["depth"]["bytes"])))
        assert own.dtype == np.uint16
        np.testing.assert_array_equal(np.asarray(view["depth"]), own)
        assert [each.size for each in view["amodal"]] == [(64, 48)] * len(row["names"])
        assert view["poses"] == row["poses"]


def test_webdataset_decodes_all_but_depth(bank, rows, tmp_path):
    wds = pytest.importorskip("webdataset", reason="needs the extra readers")
    made = cg.make_dataset(bank.path, tmp_path / "tars", form="webdataset", **ASKED)
    (file,) = made.path.glob("train-*.tar")
    found = list(wds.WebDataset(str(file), shardshuffle=False).decode("pil"))
    assert len(found) == len(rows)
    for view, row in zip(found, rows, strict=True):
        depth = np.asarray(Image.open(io.BytesIO(view["depth.png16"])))
        own = np.asarray(Image.open(io.BytesIO(row["depth"]["bytes"])))
        assert depth.dtype == np.uint16
        np.testing.assert_array_equal(depth, own)
        label = np.asarray(view["label.png"])
        np.testing.assert_array_equal(
            label[..., 0], np.asarray(Image.open(io.BytesIO(row["label"]["bytes"])))
        )
        assert view["json"]["names"] == row["names"]
    told = front_matter(made.path)
    assert "dataset_info" not in told
    assert told["configs"][0]["data_files"][0]["path"] == "train-[0-9]*.tar"
