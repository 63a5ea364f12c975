"""Supports with several surfaces, walls or a slope: what they promise, against their own collision."""

import json
import math

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.mjcf import add_support, new_spec
from cluttergen_jax.assets.support import (
    Box,
    Rectangle,
    SupportAsset,
    Surface,
    cuboid_table,
    outline_of_cells,
    ring_area,
)
from cluttergen_jax.assets.support_file import read_support, support_hash, write_support
from cluttergen_jax.assets.support_map import free_height, surface_heights
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.geometry import rotate_in_plane
from scenes.furniture import SUPPORTS, make_support

SEVERAL = [name for name in SUPPORTS if make_support(name).named]


def cells_over(heights, region, inset=0.003):
    x, y = (
        heights.origin[k] + heights.cell * (np.arange(heights.ground.shape[k]) + 0.5)
        for k in (0, 1)
    )
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), -1) - region.center
    return (np.abs(rotate_in_plane(xy, -region.yaw)) <= np.array(region.half_extents) - inset).all(
        -1
    )


@pytest.mark.parametrize("name", SEVERAL)
@pytest.mark.parametrize("seed", [None, 5])
def test_collision_is_flat_under_each_region_and_free_up_to_what_is_said(name, seed):
    support = make_support(name, seed)
    for surface in support.surfaces:
        heights = surface_heights(support, surface)
        ground = heights.ground[cells_over(heights, surface.region)]
        assert np.abs(ground).max(initial=-1.0) < 1e-6
        assert len(ground)
        assert free_height(heights, surface.region) == pytest.approx(surface.free_height, abs=1e-6)
        assert surface.area >= 4 * np.prod(surface.region.half_extents) - 1e-6
    assert support.on_surface("") is support
    chosen = support.on_surface(support.surfaces[-1].name)
    assert chosen.chosen == support.surfaces[-1]
    assert chosen.top == support.surfaces[-1].position[2]


@pytest.mark.parametrize("name", SEVERAL)
def test_a_cube_stays_at_each_corner_of_each_region(name):
    support = make_support(name)
    spec = new_spec(StabilityConfig().timestep, ContactConfig())
    add_support(spec, support)
    half = 0.015
    for number, surface in enumerate(support.surfaces):
        reach = np.asarray(surface.region.half_extents) - half - 0.003
        for index, sign in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)]):
            local = np.array(
                [*(np.asarray(surface.region.center) + np.asarray(sign) * reach), half, 1.0]
            )
            body = spec.worldbody.add_body(name=f"cube-{number}-{index}")
            body.pos = (surface.T_world_surface @ local)[:3]
            body.quat = surface.quaternion
            body.add_freejoint()
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(half, half, half), density=500)
    model = spec.compile()
    data = mujoco.MjData(model)
    start = data.qpos.reshape(-1, 7).copy()
    mujoco.mj_step(model, data, 120)
    assert np.abs(data.qpos.reshape(-1, 7) - start).max() < 1e-3


@pytest.mark.parametrize("name", ["bookcase", "tilted_board_10"])
def test_surfaces_and_parts_survive_the_disk(name, tmp_path):
    support = make_support(name).on_surface(make_support(name).surfaces[-1].name)
    again = read_support(write_support(tmp_path / name, support))
    assert support_hash(again) == support_hash(support)
    assert [each.name for each in again.surfaces] == [each.name for each in support.surfaces]
    assert again.chosen.T_world_surface == pytest.approx(support.chosen.T_world_surface, abs=1e-6)
    assert again.chosen.free_height == pytest.approx(support.chosen.free_height, abs=1e-6)
    assert len(again.parts) == len(support.parts)


def test_a_flat_top_is_one_surface_and_its_file_is_of_the_first_format(tmp_path):
    table = cuboid_table(0.4, 0.5)
    (top,) = table.surfaces
    assert (top.name, top.area, top.is_level, top.free_height) == (
        "top",
        pytest.approx(0.2),
        True,
        math.inf,
    )
    assert table.on_surface("top") is table
    record = json.loads((write_support(tmp_path / "table", table) / "support.json").read_text())
    assert record["format"] == 1
    assert "surfaces" not in record
    with pytest.raises(ConfigError, match="top"):
        table.on_surface("shelf")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda r: r["surfaces"].append(r["surfaces"][0]), "twice"),
        (lambda r: r.update(surface="attic"), "attic"),
        (lambda r: r["surfaces"][0].update(quaternion=[0.9, 0.435, 0, 0]), "degrees"),
        (lambda r: r["surfaces"][0].update(outline=[[0, 0], [1, 0]]), "corners"),
        (lambda r: r["surfaces"][0].update(free_height=-1.0), "room"),
        (lambda r: r["surfaces"][0].update(name="../x"), "called"),
        (lambda r: r["parts"].append([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), "volume"),
        (lambda r: r["parts"].append([[0, 0, 1e6], [1, 0, 0], [0, 1, 0], [1, 1, 1]]), "farther"),
        (lambda r: r.update(format=5), "format"),
    ],
)
def test_damaged_surfaces_are_refused(change, word, tmp_path):
    path = write_support(tmp_path / "bookcase", make_support("bookcase")) / "support.json"
    record = json.loads(path.read_text())
    del record["sha256"]
    change(record)
    path.write_text(json.dumps(record))
    with pytest.raises(PoolError, match=word):
        read_support(path.parent)


def test_what_stands_on_a_surface_is_ground_and_what_hangs_is_ceiling():
    boxes = (
        Box((0, 0, 0.05), (0.5, 0.5, 0.05)),
        Box((0.3, 0, 0.2), (0.1, 0.5, 0.1)),
        Box((0.3, 0, 0.31), (0.1, 0.5, 0.01)),
        Box((-0.3, 0, 0.5), (0.1, 0.1, 0.1)),
    )
    region = Rectangle((0, 0), (0.5, 0.5))
    surface = Surface("top", (0, 0, 0.1), region, tuple(map(tuple, region.corners.tolist())))
    support = SupportAsset(
        "s", "s", boxes, 0.1, region, cuboid_table().provenance, named=(surface,)
    )
    heights = surface_heights(support, surface)

    def at(x, y):
        return tuple(np.floor((np.array([x, y]) - heights.origin) / heights.cell).astype(int))

    assert heights.ground[at(0, 0)] == pytest.approx(0)
    assert heights.ceiling[at(0, 0)] == np.inf
    assert heights.ground[at(0.3, 0.2)] == pytest.approx(0.22)
    assert heights.ceiling[at(-0.3, 0.05)] == pytest.approx(0.3)
    assert free_height(heights, region) == pytest.approx(0.3)
    assert (heights.ground[[0, -1]] < -1).all()
    assert (heights.ground[:, [0, -1]] < -1).all()
    # The same as one convex part more: a wedge hangs where it is.
    part = Mesh.points(
        np.array([(x, y, z) for x in (-0.1, 0.1) for y in (0.3, 0.5) for z in (0.25, 0.4)])
    )
    more = SupportAsset(**{**support.__dict__, "parts": (part,)})
    assert surface_heights(more, surface).ceiling[at(0, 0.4)] == pytest.approx(0.15)


def test_cells_become_an_outline_with_holes():
    mask = np.ones((12, 10), bool)
    mask[3:5, 4:8] = False
    outer, hole = outline_of_cells(mask, np.zeros(2), np.array([0.1, 0.05]), 1e-3)
    assert ring_area(outer) == pytest.approx(1.2 * 0.5, abs=1e-6)
    assert ring_area(hole) == pytest.approx(-0.2 * 0.2, abs=1e-6)
