"""Imports: pools from trees of files, failures named, nothing made twice, nothing half-written."""

import errno
import shutil
import time

import pytest
import trimesh

from cluttergen_jax.assets.body import BodyConfig
from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.cli.main import load
from cluttergen_jax.errors import BankError, PoolError
from cluttergen_jax.importing import cache, run
from cluttergen_jax.importing.readers import ReadOptions, find_sources
from cluttergen_jax.importing.run import ImportConfig, ObjectConfig, import_sources
from tests.helpers.imports import made_here

QUICK = ImportConfig(ObjectConfig(trials=8), jobs=1, progress=False)


pytestmark = pytest.mark.usefixtures("home")


@pytest.fixture
def tree(tmp_path):
    """Two boxes, and a URDF that names a mesh which is not there."""
    folder = tmp_path / "tree"
    (folder / "lamp").mkdir(parents=True)
    trimesh.creation.box((0.08, 0.06, 0.04)).export(folder / "crate.obj")
    trimesh.creation.box((0.05, 0.05, 0.05)).export(folder / "cube.stl")
    (folder / "lamp" / "lamp.urdf").write_text(
        '<robot name="r"><link name="a"><visual><geometry><mesh filename="shade.obj"/></geometry></visual>'
        "</link></robot>"
    )
    return folder


def test_a_tree_becomes_a_pool_and_the_failure_is_named(tree, capsys):
    status = load("import")(
        sources=(str(tree),), pool="mine", trials=8, jobs=1, progress=False
    ).run()
    assert status == 1
    out, err = capsys.readouterr()
    assert "shade.obj" in err
    pool = find_pool("mine")
    assert pool.names == ("crate", "cube")
    assert all(asset.quality.solo_rate == 1.0 for asset in pool.objects)
    assert "2 stand alone in 99 % of trials or more" in out
    assert load("inspect")("mine").run() == 0
    assert "crate" in capsys.readouterr().out


@pytest.fixture
def here(monkeypatch):
    """Jobs run in this process: spawning has its own tests, and costs seconds."""
    monkeypatch.setattr(run, "_outcomes", made_here)


def test_an_unchanged_pool_is_read_not_made(tree, here):
    first = import_sources([tree / "crate.obj"], "mine", QUICK)
    start = time.perf_counter()
    second = import_sources([tree / "crate.obj"], "mine", QUICK)
    assert time.perf_counter() - start < 1.0
    assert (first.num_cached, second.num_cached) == (0, 1)
    assert not second.failures


def test_changed_content_needs_force(tree, here):
    import_sources([tree / "crate.obj"], "mine", QUICK)
    with pytest.raises(PoolError, match="`force`"):
        import_sources([tree / "cube.stl"], "mine", QUICK)
    assert find_pool("mine").names == ("crate",)
    forced = ImportConfig(QUICK.object, 1, force=True, progress=False)
    import_sources([tree / "cube.stl"], "mine", forced)
    assert find_pool("mine").names == ("cube",)


def test_keys_see_bytes_settings_and_companions(tree):
    (source,) = find_sources(tree / "crate.obj")
    keys = {
        cache.cache_key(source, config)
        for config in (
            ObjectConfig(),
            ObjectConfig(trials=8),
            ObjectConfig(read=ReadOptions(mass=0.1)),
            ObjectConfig(body=BodyConfig("light")),
            ObjectConfig(body=BodyConfig(decomposition=DecompositionConfig(threshold=0.1))),
        )
    }
    assert len(keys) == 5
    before = cache.cache_key(source, ObjectConfig())
    (tree / "crate.mtl").write_text("newmtl red\nKd 1 0 0\n")
    assert cache.cache_key(source, ObjectConfig()) != before


def test_a_damaged_entry_is_made_again(tree, here):
    import_sources([tree / "crate.obj"], "mine", QUICK)
    (entry,) = cache.cache_root().iterdir()
    (entry / "cloud.npy").write_bytes(b"")
    assert import_sources([tree / "crate.obj"], "mine", QUICK).num_cached == 0


def test_a_home_that_takes_no_files_is_told_before_any_work(tree, monkeypatch):
    def refuse(dir):
        raise OSError(errno.EROFS, "Read-only file system", str(dir))

    monkeypatch.setattr(run, "TemporaryFile", refuse)
    monkeypatch.setattr(run, "_make", lambda *_: pytest.fail("work was done"))
    with pytest.raises(BankError, match=r"cannot be written: Read-only file system"):
        import_sources([str(tree)], "mine", QUICK)


def test_a_copy_of_what_was_imported_says_where_it_lies_and_may_come_again(tree, tmp_path, here):
    import_sources([tree / "crate.obj"], "one", QUICK)
    copy = tmp_path / "copy"
    shutil.copytree(tree, copy)
    for _ in range(2):
        report = import_sources([copy / "crate.obj"], "two", QUICK)
        assert report.num_cached == 1
    assert find_pool("two")["crate"].provenance.source.endswith("copy/crate.obj")
    assert not find_pool("one")["crate"].provenance.source.endswith("copy/crate.obj")
