"""Supports on disk: what is read is what was written, and damage is named."""

import numpy as np
import pytest

from cluttergen_jax.assets.support_file import (
    find_support,
    list_supports,
    read_support,
    write_support,
)
from scenes.furniture import SUPPORTS, make_support


def assert_same(left, right):
    assert (left.name, left.label, left.provenance) == (right.name, right.label, right.provenance)
    assert left.top == pytest.approx(right.top, abs=1e-7)
    np.testing.assert_allclose(left.region.center, right.region.center, atol=1e-7)
    np.testing.assert_allclose(left.region.half_extents, right.region.half_extents, atol=1e-7)
    assert len(left.boxes) == len(right.boxes)
    for a, b in zip(left.boxes, right.boxes, strict=True):
        np.testing.assert_allclose(
            (*a.center, *a.half_extents, a.yaw), (*b.center, *b.half_extents, b.yaw), atol=1e-7
        )
        np.testing.assert_allclose(a.rgba, b.rgba, atol=1e-7)
    for a, b in zip(left.pieces, right.pieces, strict=True):
        np.testing.assert_allclose(a.rgba, b.rgba, atol=1e-7)
        np.testing.assert_array_equal(a.mesh.faces, b.mesh.faces)
        np.testing.assert_allclose(a.mesh.vertices, b.mesh.vertices, atol=1e-6)


@pytest.mark.parametrize("name", ["table", "round_table", "tray_table", "picnic_table"])
def test_write_and_read_are_inverse(name, tmp_path):
    support = make_support(name, 7)
    folder = write_support(tmp_path / "any" / "place", support)
    once = read_support(folder)
    assert_same(once, support)
    again = write_support(tmp_path / "again", once)
    assert {f.name: f.read_bytes() for f in again.iterdir()} == {
        f.name: f.read_bytes() for f in folder.iterdir()
    }
    assert {f.name for f in tmp_path.iterdir()} == {"any", "again"}


def test_embedded_supports_are_what_the_modeller_makes(tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path))
    assert set(list_supports()) == set(SUPPORTS)
    for name in SUPPORTS:
        assert_same(find_support(name), make_support(name))
