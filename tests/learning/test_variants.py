"""Variants: equally many of each family, none of a held-out one, the same before and after the cache."""

import pytest

from cluttergen_jax.assets.body import make_object
from cluttergen_jax.assets.modeller.catalog import make_shape
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing import cache
from cluttergen_jax.learning.training import worlds as module
from cluttergen_jax.learning.training.worlds import (
    ShapeVariant,
    variants,
)

PAIR = ("cereal_box", "fork")


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path))
    return cache.cache_root()


def refuse(*args):
    raise AssertionError("a body was made that is in the cache")


@pytest.mark.slow
def test_bodies_come_from_the_cache_unchanged(home, monkeypatch):
    made = variants(3, 5, PAIR, num_processes=1)
    assert [asset.name for asset in made] == ["cereal_box-5", "fork-5", "cereal_box-6"]
    assert len({object_hash(asset) for asset in made}) == 3
    assert object_hash(made[1]) == object_hash(make_object(make_shape("fork", 5)))
    monkeypatch.setattr(module, "run_all", refuse)
    again = variants(3, 5, PAIR)
    assert [object_hash(asset) for asset in again] == [object_hash(asset) for asset in made]
    assert not list(home.glob(".*"))


def test_a_body_that_fails_is_named_and_the_others_stay(home, monkeypatch):
    def some(function, jobs, num_processes):
        for index, job in enumerate(jobs):
            yield index, "no convex part" if job.family == "fork" else function(job)

    monkeypatch.setattr(module, "run_all", some)
    with pytest.raises(AssetError, match=r"fork-0: no convex part"):
        variants(2, 0, PAIR)
    assert cache.load(ShapeVariant("cereal_box", 0).key, "cereal_box-0") is not None
