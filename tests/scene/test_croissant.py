"""`croissant.json` beside a bank: it validates, and rows are read by it, in the library that defines it."""

import json

import numpy as np
import pytest

from cluttergen_jax.scene.bank import read_bank, write_card
from cluttergen_jax.scene.bank.croissant import CROISSANT
from tests.helpers import banks


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    """A bank of two blocks with its card and its description."""
    path = tmp_path_factory.mktemp("banks") / "bank"
    banks.write(path)
    write_card(read_bank(path))
    return path


def test_every_column_is_a_field_of_its_type(described):
    told = json.loads((described / CROISSANT).read_text())
    (scenes,) = told["recordSet"]
    fields = {each["name"]: each for each in scenes["field"]}
    assert list(fields) == read_bank(described).table.schema.names
    kinds = {name: (each["dataType"], each.get("repeated", False)) for name, each in fields.items()}
    assert kinds["index"] == ("sc:Integer", False)
    assert kinds["is_success"] == ("sc:Boolean", False)
    assert kinds["poses"] == ("sc:Float", True)
    assert kinds["objects"] == ("sc:Text", True)
    assert all(each["description"] for each in fields.values())
    bank = read_bank(described)
    assets = [bank.support, *(bank.object(name) for name in bank.assets["objects"])]
    assert told["license"] == sorted({each.provenance.licence for each in assets})


def test_a_description_of_the_users_own_stays(tmp_path):
    banks.write(tmp_path / "bank", 1)
    place = tmp_path / "bank" / CROISSANT
    place.write_text("{}")
    write_card(read_bank(tmp_path / "bank"))
    assert place.read_text() == "{}"


def test_it_validates_and_rows_are_read_by_it(described, caplog):
    mlc = pytest.importorskip("mlcroissant", reason="needs the extra readers")
    dataset = mlc.Dataset(str(described / CROISSANT))
    assert not dataset.metadata.ctx.issues.errors
    # Who publishes it, and when, the maker does not know.
    assert all(
        "datePublished" in each or "citeAs" in each for each in dataset.metadata.ctx.issues.warnings
    )
    assert not [each for each in caplog.records if "context" in each.getMessage()]
    found = list(dataset.records("scenes"))
    rows = read_bank(described).table.to_pylist()
    assert len(found) == len(rows) == 512
    for record, row in list(zip(found, rows, strict=True))[::37]:
        own = {name.removeprefix("scenes/"): value for name, value in record.items()}
        assert own["index"] == row["index"]
        assert own["verdict"] == row["verdict"].encode()
        assert own["shake"] is None
        np.testing.assert_array_equal(own["poses"], row["poses"])
        assert own["objects"] == [name.encode() for name in row["objects"]]
