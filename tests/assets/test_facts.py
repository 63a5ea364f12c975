"""Objects chosen and weighed by what is told of them."""

import json

import numpy as np
import pytest

from cluttergen_jax.assets import pool as pools
from cluttergen_jax.assets.facts import ObjectFacts, chosen_names, parse_weights, weights_of
from cluttergen_jax.assets.pool import Pool, StoredObjects, find_pool, read_pool, write_pool
from cluttergen_jax.errors import ConfigError, PoolError
from tests.helpers.worlds import trio


def facts(name, label, size=(0.1, 0.05, 0.2), volume=1e-3, mass=0.5, licence="CC0"):
    return ObjectFacts(name, label, size, volume, mass, licence, "file.obj", 2, False)


SHELF = (
    facts("mug_red", "coffee mug", volume=3e-4, mass=0.3),
    facts("mug_tall", "coffee mug", volume=9e-4, mass=0.4),
    facts("atlas", "Book of maps", size=(0.2, 0.3, 0.02), mass=1.1, licence="CC-BY-4.0"),
)


@pytest.mark.parametrize(
    ("chosen", "names"),
    [
        (("mug*",), ("mug_red", "mug_tall")),
        (("mug* and volume<0.0005",), ("mug_red",)),
        (("label=*book*",), ("atlas",)),
        (("licence=cc0 and mass >= 0.4",), ("mug_tall",)),
        (("width>0.25", "mug_red"), ("atlas", "mug_red")),
        (("height<=0.02", "depth=0.2"), ("atlas",)),
        (("flagged=0",), ("mug_red", "mug_tall", "atlas")),
        (("never_heard_of",), ("never_heard_of",)),
    ],
)
def test_objects_are_chosen(chosen, names):
    assert chosen_names(SHELF, chosen, "mine") == names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cup*", "chooses no object of pool 'mine'"),
        ("weight<1", "'weight<1' in a choice.*height.*Try"),
        ("volumes<1", "Did you mean 'volume'"),
        ("mass<much", "'much' in 'mass<much'. Allowed: a number"),
        ("label<a", "label=PATTERN"),
        ("mug* and ", "'mug. and' in a choice"),
    ],
)
def test_a_choice_that_is_none_is_refused(text, message):
    with pytest.raises(ConfigError, match=message):
        chosen_names(SHELF, (text,), "mine")


def test_weights_multiply():
    weights = parse_weights("mug*=3; label=*book*=0; mass>0.35=2;")
    assert weights == (("mug*", 3.0), ("label=*book*", 0.0), ("mass>0.35", 2.0))
    np.testing.assert_array_equal(weights_of(SHELF, weights), [3.0, 6.0, 0.0])
    with pytest.raises(ConfigError, match="which no object fulfils"):
        weights_of(SHELF, (("cup*", 2.0),))
    for text in ("mug*", "mug*=-1", "=2", "mug*=inf"):
        with pytest.raises(ConfigError, match="CONDITION=NUMBER"):
            parse_weights(text)


def test_of_a_large_pool_objects_are_read_when_they_are_asked_for(tmp_path, monkeypatch):
    objects = tuple(trio())
    path = write_pool(tmp_path / "three", Pool("three", objects))
    told = read_pool(path).facts
    monkeypatch.setattr(pools, "MOST_READ", 2)
    read = []
    real = pools.read_object
    monkeypatch.setattr(
        pools, "read_object", lambda folder: read.append(folder.name) or real(folder)
    )
    pool = find_pool(path)
    assert isinstance(pool.objects, StoredObjects)
    assert pool.names == tuple(asset.name for asset in objects)
    assert pool.facts == told == tuple(map(ObjectFacts.of, objects))
    assert read == []
    name = pool.names[1]
    assert pool[name].name == name
    assert pool.objects[1] is pool[name]
    assert read == [name]
    assert find_pool(f"{path}~{pool.names[0]}").names == pool.names[1:]
    assert find_pool(path, exclude=[f"{pool.names[0][:-1]}*"]).names == pool.names[1:]
    (path / pool.names[2] / "cloud.npy").unlink()
    with pytest.raises(PoolError, match=r"cloud\.npy"):
        pool[pool.names[2]]


def test_a_pool_without_facts_tells_those_of_its_objects(tmp_path):
    path = write_pool(tmp_path / "three", Pool("three", tuple(trio())))
    index = path / "pool.json"
    known = read_pool(path).facts
    record = pools.checked_record(index.read_bytes())
    del record["facts"]
    index.write_text(json.dumps(record))
    assert read_pool(path).facts == known
