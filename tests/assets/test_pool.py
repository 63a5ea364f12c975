"""Pools on disk: what is written is what is read, and damage is named."""

import dataclasses

import numpy as np
import pytest

from cluttergen_jax.assets import pool as pools
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.pool import Pool, find_pool, read_pool, write_pool
from cluttergen_jax.errors import PoolError
from tests.helpers.shapes import make_box


@pytest.fixture
def pool():
    return Pool(
        "two", (make_box("tall"), make_box("flat", (0.05, 0.05, 0.01), seed=1)), licence="CC0"
    )


def test_what_is_written_is_read(tmp_path, pool):
    path = write_pool(tmp_path / "two", pool)
    again = read_pool(path)
    assert (again.name, again.names, again.tier, again.licence) == (
        "two",
        pool.names,
        "standard",
        "CC0",
    )
    for old, new in zip(pool.objects, again.objects, strict=True):
        for field in ("label", "mass", "resting", "provenance", "quality", "flags", "tier"):
            assert getattr(old, field) == getattr(new, field)
        np.testing.assert_array_equal(old.cloud, new.cloud)
        np.testing.assert_allclose(old.inertia, new.inertia, rtol=1e-6)
        np.testing.assert_allclose(old.parts[0].vertices, new.parts[0].vertices, atol=1e-7)
        np.testing.assert_allclose(
            old.pieces[0].mesh.vertices, new.pieces[0].mesh.vertices, atol=1e-6
        )
        np.testing.assert_array_equal(old.pieces[0].mesh.faces, new.pieces[0].mesh.faces)


def test_hash_survives_the_disk_and_sees_every_change(tmp_path, pool):
    assert read_pool(write_pool(tmp_path / "a", pool)).hash == pool.hash
    asset = pool.objects[0]
    changes = [
        {"mass": 0.26},
        {"flags": ()},
        {"cloud": asset.cloud + 1e-6},
        {"parts": (Mesh.points(asset.parts[0].vertices + 1e-6),)},
        {"pieces": (dataclasses.replace(asset.pieces[0], rgba=(0.0, 0.2, 0.3, 1.0)),)},
    ]
    hashes = {object_hash(dataclasses.replace(asset, **change)) for change in changes}
    assert len(hashes | {object_hash(asset)}) == len(changes) + 1


@pytest.mark.parametrize("name", ["object.json", "visual-0.obj", "cloud.npy"])
@pytest.mark.parametrize("harm", ["cut", "gone", "changed"])
def test_a_damaged_file_is_named(tmp_path, pool, name, harm):
    path = write_pool(tmp_path / "two", pool) / "flat" / name
    data = path.read_bytes()
    if harm == "gone":
        path.unlink()
    else:
        path.write_bytes(data[:-20] if harm == "cut" else data.replace(b"0", b"1", 1))
    with pytest.raises(PoolError, match=rf"flat/{name}"):
        read_pool(tmp_path / "two")


def test_nothing_is_overwritten_untold(tmp_path, pool):
    path = write_pool(tmp_path / "two", pool)
    with pytest.raises(PoolError, match="exists"):
        write_pool(path, pool)
    other = Pool("two", pool.objects[:1])
    write_pool(path, other, overwrite=True)
    assert read_pool(path).names == ("tall",)
    assert [each.name for each in tmp_path.iterdir()] == ["two"]
    (tmp_path / "notes").mkdir()
    with pytest.raises(PoolError, match="exists"):
        write_pool(tmp_path / "notes", pool, overwrite=True)


def test_all_is_the_union_and_clashes_are_prefixed(tmp_path, monkeypatch):
    monkeypatch.setattr(pools, "embedded_root", lambda: tmp_path)
    write_pool(tmp_path / "pools" / "study", Pool("study", (make_box("box"), make_box("lamp"))))
    write_pool(tmp_path / "pools" / "dining", Pool("dining", (make_box("box"),)))
    assert find_pool("all").names == ("dining-box", "study-box", "lamp")


def test_names_are_unique_and_plain(pool):
    with pytest.raises(PoolError, match="twice"):
        Pool("two", (make_box(), make_box()))
    with pytest.raises(PoolError, match="called"):
        Pool("../two", pool.objects)
