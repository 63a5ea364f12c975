"""Pools put together: unions, all but some, added to, shown and removed; and banks that name such a pool."""

from dataclasses import replace

import pytest
import trimesh

from cluttergen_jax.assets.pool import Pool, find_pool, user_root, write_pool
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import PoolError
from cluttergen_jax.importing import run
from cluttergen_jax.importing.run import ImportConfig, ObjectConfig, import_sources
from tests.helpers.imports import made_here
from tests.helpers.shapes import make_box

QUICK = ObjectConfig(trials=8)


@pytest.fixture(autouse=True)
def pools_of_a_user(home, monkeypatch):
    """Two pools of the user's own: a holds mug and pan, b holds another mug and a lid."""
    monkeypatch.setattr(run, "_outcomes", made_here)
    write_pool(user_root() / "a", Pool("a", (make_box("mug"), make_box("pan")), licence="CC0"))
    write_pool(
        user_root() / "b", Pool("b", (make_box("mug", seed=1), make_box("lid")), licence="MIT")
    )


def test_all_but_some():
    assert find_pool("a~mug").names == find_pool("a", exclude=("mug",)).names == ("pan",)
    assert find_pool("a+b~a-mug~lid").names == ("pan", "b-mug")
    assert find_pool("a~mug").hash == Pool("other", (find_pool("a")["pan"],)).hash
    assert len(find_pool("all", ["mug"])) == 49


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a+c", "'c'"),
        ("a+", "''"),
        ("a~jug", "no object 'jug'.*mug, pan"),
        ("a~mug~pan", "no object left"),
        ("a+a", "different names"),
        ("a+light", "one tier"),
    ],
)
def test_what_cannot_be_put_together(text, message):
    lean = replace(make_box("bar"), tier="light")
    write_pool(user_root() / "light", Pool("light", (lean,), tier="light"))
    with pytest.raises(PoolError, match=message):
        find_pool(text)


def test_adding_to_a_pool(tmp_path):
    crate = tmp_path / "crate.obj"
    cube = tmp_path / "cube.obj"
    trimesh.creation.box((0.08, 0.06, 0.04)).export(crate)
    trimesh.creation.box((0.05, 0.05, 0.05)).export(cube)

    def add(path, **how):
        return import_sources([path], "a", ImportConfig(QUICK, 1, progress=False, **how))

    assert len(add(crate, add=True).objects) == 1
    assert find_pool("a").names == ("mug", "pan", "crate")
    assert set(find_pool("a").licence.split("; ")) == {"CC0", "not stated"}
    # The same again changes nothing.
    assert add(crate, add=True).num_cached == 1
    assert find_pool("a").names == ("mug", "pan", "crate")
    # Another object of that name is refused, or replaced where it was.
    cube.replace(crate)
    with pytest.raises(PoolError, match=r"other objects called crate.*`force`"):
        add(crate, add=True)
    assert find_pool("a")["crate"].half_extents[0] == pytest.approx(0.04, abs=1e-4)
    add(crate, add=True, force=True)
    assert find_pool("a").names == ("mug", "pan", "crate")
    assert find_pool("a")["crate"].half_extents[0] == pytest.approx(0.025, abs=1e-4)
    with pytest.raises(PoolError, match=r"not among your own.*a, b"):
        import_sources([crate], "nowhere", ImportConfig(QUICK, 1, progress=False, add=True))


def test_show_list_and_remove(capsys, monkeypatch):
    assert main(["pool", "show", "a+b~lid"]) == 0
    out = capsys.readouterr().out
    assert "a-mug" in out
    assert "60 x 40 x 82" in out
    assert "! pan: a flag" in out
    assert main(["pool", "show", "a", "--objects", "m*"]) == 0
    out = capsys.readouterr().out
    assert "1 of them are chosen" in out
    assert "! pan" not in out
    assert main(["pool", "show", "a", "--objects", "mass>100"]) == 2
    assert "chooses no object of pool 'a'" in capsys.readouterr().err
    assert main(["pool", "show", "a", "--page", "2"]) == 2
    assert "Allowed: 1." in capsys.readouterr().err
    monkeypatch.setattr("cluttergen_jax.cli.pools._PAGE", 1)
    assert main(["pool", "show", "a", "--page", "2"]) == 0
    out = capsys.readouterr().out
    assert "page 2 of 2" in out
    assert "mug" not in out.split("another:")[0]
    assert main(["pool", "list"]) == 0
    assert str(user_root() / "a") in capsys.readouterr().out
    assert main(["pool", "remove", "a", "nothing"]) == 2
    assert (user_root() / "a").is_dir()
    assert main(["pool", "remove", "dining"]) == 2
    assert "'dining' is embedded" in capsys.readouterr().err
    assert main(["pool", "remove", "a"]) == 0
    assert "removed pool a (2 objects: mug, pan)" in capsys.readouterr().out
    assert [each.name for each in user_root().iterdir()] == ["b"]
    (user_root() / "b" / "mug" / "object.json").write_text("{}")
    assert main(["pool", "remove", "b"]) == 0
    assert "damaged" in capsys.readouterr().out
    assert not list(user_root().iterdir())
    assert main(["pool", "show"]) == main(["pool", "list", "a"]) == 2
