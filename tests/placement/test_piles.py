"""Piles and packed scenes as users ask for them: what is refused, and scenes that every door gives alike."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapely import MultiPoint
from shapely.geometry import box as rectangle

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.assets.support_map import rim_height
from cluttergen_jax.config import PILE_NOSLIP
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.generation.sampler import set_up_bank
from cluttergen_jax.generation.sources.replay import replay, replay_context_of
from cluttergen_jax.learning.methods import sampler_of
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.outlines import directions
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.region import make_region
from cluttergen_jax.placement.rollout import Rollout
from cluttergen_jax.placement.room import (
    USUALLY_FULL,
    check_crowding,
    check_room,
    share_packed,
    split_by_room,
)
from cluttergen_jax.placement.side_by_side import pairs_without_room
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import box, prism


def test_a_container_has_the_size_of_its_name():
    support = find_support("bin-0.50x0.30x0.20")
    assert support.region.half_extents == pytest.approx((0.25, 0.15))
    assert rim_height(support.region, support) == pytest.approx(0.20)
    assert rim_height(find_support("tray").region, find_support("tray")) == pytest.approx(0.04)
    inner = Rectangle((0.0, 0.0), (0.1, 0.1))
    assert rim_height(inner, support) == 0
    assert rim_height(find_support("table").region, find_support("table")) == 0
    for name in ("bin-0.50x9", "tote-0.001x0.4", "tray-0.3x0.3x0.0"):
        with pytest.raises(ConfigError, match="each side between"):
            find_support(name)


@pytest.mark.parametrize(
    "options",
    [
        {"keep_out": ("0,0,0.1,0.1",)},
        {"start": "bank:0"},
        {"ruin_after": 3},
        {"min_margin": 0.003},
        {"for_engine": "drake"},
        {"robust": True},
        {"overhang": "half"},
        {"engine": "warp"},
        {"natural": True},
        {"height": "free"},
        {"clearance": 0.01},
    ],
)
def test_a_pile_refuses_what_it_cannot_give(options):
    with pytest.raises(ConfigError, match="pile"):
        cg.make_sampler(support="bin", method="pile", **options)


def test_clearance_is_for_packed_scenes_and_within_limits():
    with pytest.raises(ConfigError, match="packed"):
        cg.SceneSpec(clearance=0.01).check_method("guided")
    for clearance in (0.0, float("nan"), 1.0):
        with pytest.raises(ConfigError, match="clearance"):
            cg.SceneSpec(method="packed", clearance=clearance)


def test_an_overfull_bin_is_refused_with_the_number_that_fits():
    cubes = [box(f"cube-{i}", (0.0499, 0.0499, 0.0499)) for i in range(40)]
    support = find_support("bin")
    config = cg.SceneSpec(method="pile", support="bin", num_objects=10).problem_config("pile")
    assert isinstance(config, ProblemConfig)
    check_crowding(cubes, config, support)
    crowded = replace(config, placement=replace(config.placement, num_objects=30))
    # 18 litres hold 18 cubes of nearly a litre.
    with pytest.raises(ConfigError, match="up to 18 "):
        check_crowding(cubes, crowded, support)


def test_what_cannot_lie_inside_a_container_is_refused_by_name_and_size():
    support = find_support("bin-0.20x0.16x0.10")
    objects = [
        box("cube", (0.04, 0.04, 0.04)),
        box("board", (0.12, 0.1, 0.01)),
        box("rod", (0.17, 0.01, 0.01)),
    ]
    # On its narrow side, diagonally: as long as the room's diagonal, and low enough.
    objects.append(box("plate", (0.12, 0.09, 0.005)))
    rules = PlacementConfig(num_objects=1)
    with pytest.raises(ConfigError) as told:
        check_room(objects, support, support.region, rules, is_piled=True)
    assert "support 'bin', 0.20 x 0.16 x 0.10 m inside its walls" in told.value.given
    assert "board (0.24 x 0.20 x 0.02 m), rod (0.34 x 0.02 x 0.02 m)" in told.value.given
    # The advice works.
    assert told.value.hint == "support='bin-0.35x0.21x0.10'"
    larger = find_support("bin-0.35x0.21x0.10")
    check_room(objects, larger, larger.region, rules, is_piled=True)
    check_room([objects[0], objects[3]], support, support.region, rules, is_piled=True)
    # Upright, a plate has to lie flat; a rod that stands is no longer one that lies.
    with pytest.raises(ConfigError, match=r"as they stand: board .*, rod .*, plate "):
        check_room(objects, support, support.region, rules)
    check_room([box("pole", (0.01, 0.01, 0.17))], support, support.region, rules)
    # On an open table an object may reach over the region's sides, unless its whole footprint counts.
    table = find_support("table")
    check_room(objects, table, Rectangle(half_extents=(0.1, 0.08)), rules)
    whole = replace(rules, containment="footprint")
    with pytest.raises(ConfigError, match=r"a region of 0.20 x 0.16 m, as they stand: board"):
        check_room(objects, table, Rectangle(half_extents=(0.1, 0.08)), whole)


@pytest.mark.parametrize("options", [{}, {"shelf": 2, "method": "random"}])
def test_objects_that_are_too_large_are_refused_by_name_or_left_out(tmp_path, options):
    objects = [
        box("cube", (0.02, 0.02, 0.02)),
        box("ball", (0.03, 0.02, 0.02)),
        box("slab", (0.2, 0.2, 0.01)),
    ]
    blocks = write_pool(tmp_path / "blocks", Pool("blocks", tuple(objects)))
    asked = {
        "pool": blocks,
        "support": "bin-0.20x0.16x0.10",
        "method": "pile",
        "num_objects": 2,
    } | options
    named = asked | {"objects": ("cube", "ball", "slab")}
    with pytest.raises(
        ConfigError, match=r"slab \(0.40 x 0.40 x 0.02 m\).*Try: support='bin-0.41x0.41x0.10'"
    ):
        cg.make_sampler(**named)
    # Nobody asked for the slab: the others are drawn instead, and it is said.
    for pattern in ((), ("*",), ("cube", "*l*")):
        sample = cg.make_sampler(**asked | {"objects": pattern})
        assert set(sample.names) == {"cube", "ball"}
        assert sample.problem.notes == ("too large for support 'bin', and left out: slab",)
    with pytest.raises(ConfigError, match=r"3 objects, of which 2 are left; .*left out: slab"):
        cg.make_sampler(**asked | {"num_objects": 3, "shelf": None})
    high = write_pool(
        tmp_path / "high", Pool("high", (*objects[:2], box("pole", (0.02, 0.02, 0.4))))
    )
    on_shelf = {"pool": high, "support": "rack", "surface": "shelf_1", "method": "random"}
    with pytest.raises(ConfigError, match="too tall for shelf_1"):
        cg.make_sampler(**asked | on_shelf)


def test_the_largest_objects_are_left_out_of_a_pile_that_would_overflow():
    support = find_support("bin-0.20x0.16x0.10")
    objects = [box(f"cube-{i}", (0.02 + 0.002 * i,) * 3) for i in range(20)]
    config = cg.SceneSpec(method="pile", support="bin", num_objects=8).problem_config("pile")

    def left(num_objects, named=()):
        placement = replace(config.placement, num_objects=num_objects)
        asked = replace(config, placement=placement)
        kept, notes = split_by_room(objects, named, support, support.region, asked)
        return [each.name for each in kept], notes

    assert left(2) == ([each.name for each in objects], ())
    names, (note,) = left(10)
    # The largest ones, and no others; the least that helps.
    assert names == [each.name for each in objects[: len(names)]]
    assert "would fill support 'bin' too much" in note
    assert 10 <= len(names) < 20
    volumes = [np.prod(2 * each.half_extents) for each in objects[: len(names)]]
    room = 0.2 * 0.16 * 0.1
    draws = [np.random.default_rng(i).choice(volumes, 10, False).sum() / room for i in range(200)]
    assert np.quantile(draws, 0.9) < USUALLY_FULL + 0.05
    # What was asked for by name stays, and others go for it.
    kept, _ = left(9, named=("cube-14",))
    assert "cube-14" in kept
    assert "cube-13" not in kept
    # Where no choice helps, it is said.
    kept, (note,) = left(10, named=("cube-19",))
    assert len(kept) == 20
    assert "in many draws, of which some end outside" in note


def test_what_finds_no_room_side_by_side_is_refused_before_anything_is_placed():
    support = find_support("tray")
    tiles = [box(f"tile-{i}", (0.05, 0.05, 0.01)) for i in range(16)]
    asked = cg.SceneSpec(method="packed", support="tray", num_objects=12, repeat=True)
    config = asked.problem_config("packed")
    check_crowding(tiles, config, support)
    many = replace(config, placement=replace(config.placement, num_objects=14))
    with pytest.raises(ConfigError, match=r"14 objects side by side.*cover 1\.0 times") as told:
        check_crowding(tiles, many, support)
    # The advice works; and what lies on others needs no room.
    most = int(told.value.hint.split("=")[1].split(",")[0])
    fewer = replace(config.placement, num_objects=most)
    check_crowding(tiles, replace(config, placement=fewer), support)
    check_crowding(tiles, replace(many, placement=replace(many.placement, most_stacked=3)), support)
    mean, nearly_all = share_packed(tiles, fewer, 0.45 * 0.32)
    assert mean == pytest.approx(nearly_all)
    assert mean == pytest.approx(most * (0.01 + 0.4 * 0.0015) / (0.45 * 0.32))


def corners_of(*sizes):
    """f64[K, 1, D, 2]: of rectangles, as `Outlines` has them."""
    half = np.array(sizes)[:, None] / 2
    return (np.where(directions() >= 0, 1.0, -1.0) * half)[:, None]


def test_pairs_that_find_no_room_side_by_side_are_found():
    half = np.array([0.225, 0.16])
    sizes = ((0.33, 0.125), (0.245, 0.185), (0.185, 0.18), (0.05, 0.05))
    found = pairs_without_room(corners_of(*sizes), half, 0.003)
    # 0.125 + 0.185, three gaps and small turns are more than 0.32; 0.125 + 0.18 are not.
    assert np.argwhere(np.triu(found)).tolist() == [[0, 1]]
    assert not pairs_without_room(corners_of(*sizes), half, 0.001).any()
    # Turned by 45 degrees two may have room where none of their boxes has.
    wide = pairs_without_room(corners_of((0.38, 0.02), (0.13, 0.13)), np.array([0.15, 0.15]), 0.001)
    assert not wide[0, 1]


def test_packed_names_what_does_not_fit_side_by_side(tmp_path):
    long = [box(f"long-{i}", (0.16, 0.085 + 0.001 * i, 0.02)) for i in range(2)]
    objects = (*long, *(box(f"small-{i}", (0.02, 0.02, 0.02)) for i in range(2)))
    pool = str(write_pool(tmp_path / "mixed", Pool("mixed", objects)))
    spec = cg.SceneSpec(pool=pool, support="tray", method="packed", num_objects=2)
    (note,) = make_problem(spec.problem_config("packed")).notes
    assert "of 100 draws of 2 objects 8" in note
    assert "as these do not: long-0 with long-1; without long-0 every two do" in note
    both = cg.SceneSpec(
        pool=pool, objects=("long-0", "long-1"), support="tray", method="packed", num_objects=2
    )
    with pytest.raises(ConfigError, match=r"not fit side by side, 3 mm apart.*long-0 with long-1"):
        make_problem(both.problem_config("packed"))


def test_packed_takes_the_target_stack_alone():
    spec = cg.SceneSpec(method="packed", clutter="stack=2")
    spec.check_method("packed")
    assert spec.problem_config("packed").placement.most_stacked == 2
    assert cg.SceneSpec(method="packed").problem_config("packed").placement.most_stacked == 0
    assert cg.SceneSpec().problem_config("guided").placement.most_stacked is None
    for clutter in ("near=0.02", "stack=2,contained=1"):
        with pytest.raises(ConfigError, match=r"with method 'packed'. Allowed: stack, the most"):
            cg.SceneSpec(method="packed", clutter=clutter).check_method("packed")


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    objects = [box(f"box-{i}", (0.02 + 0.004 * i, 0.03, 0.02)) for i in range(5)] + [
        prism("can", 0.03, 0.02)
    ]
    return str(
        write_pool(tmp_path_factory.mktemp("pools") / "blocks", Pool("blocks", tuple(objects)))
    )


def pile_of(pool, **options):
    given = {"num_objects": 4, "support": "bin-0.20x0.16x0.10", "method": "pile"} | options
    return cg.SceneSpec(pool=pool, **given)


@pytest.mark.slow
def test_sampler_rollout_and_bank_give_the_same_piles(pool, tmp_path):
    spec = pile_of(pool)
    sample = cg.make_sampler(spec)
    keys = jax.vmap(lambda i: jax.random.fold_in(jax.random.key(0), i))(np.arange(3))
    scenes = jax.jit(jax.vmap(sample))(keys)
    assert scenes.is_success.all()
    assert scenes.is_placed.all()
    np.testing.assert_array_equal(jax.jit(sample)(keys[2]).poses, scenes.poses[2])
    counts = scenes.counts
    assert (counts.attempts.sum(1) == counts.verdicts.sum(1)).all()
    assert (counts.verdicts[:, 0] == 4).all()
    method, setup, _ = set_up_bank(spec, 0)
    rolled = Rollout().run(
        sampler_of(setup, method), jax.random.key(0), np.arange(3), np.ones(3, bool)
    )
    np.testing.assert_array_equal(rolled.poses, scenes.poses)
    cg.generate(tmp_path / "bank", spec, num_scenes=3, render=False)
    bank = read_bank(tmp_path / "bank")
    stored = next(iter(bank.tables(["poses", "is_success"])))
    np.testing.assert_array_equal(np.stack(stored["poses"].to_pylist()), scenes.poses)
    assert bank.spec.method == "pile"
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "bank/scenes/000000.xml"))
    assert model.opt.noslip_iterations == PILE_NOSLIP > 0
    with pytest.raises(BankError, match="pile"):
        replay(bank, replay_context_of(bank), 0, SimpleNamespace(title="scene 0"))
    (row,) = cg.evaluate(("pile",), spec=spec, trials=3).rows
    assert (row["success"], row["placed"]) == (1.0, 4.0)
    assert row["attempts_per_valid_scene"] == pytest.approx(counts.attempts.sum() / 3)


@pytest.mark.slow
def test_a_pile_follows_its_region_and_its_shelf(pool):
    sample = cg.make_sampler(
        pile_of(pool, support="table", region="0.3x0.3", containment="footprint")
    )
    region = make_region((0.1, -0.05), (0.1, 0.14), 0.5, sample.problem.world.support.top)
    scenes = jax.jit(jax.vmap(lambda key: sample(key, region=region)))(
        jax.random.split(jax.random.key(1), 4)
    )
    local = jax.vmap(jax.vmap(region.T_world_region.inverse().apply))(scenes.poses[..., :3])
    good = np.asarray(scenes.is_success)
    assert good.any()
    assert (np.abs(local)[good][..., :2] <= region.half_extents).all()
    shelf = cg.make_sampler(pile_of(pool, shelf=5))
    many = jax.jit(lambda sample, keys: jax.vmap(sample)(keys))
    for key in jax.random.split(jax.random.key(2), 2):
        shelf = shelf.reshelve(key)
        assert many(shelf, jax.random.split(key, 2)).is_success.all()


@pytest.mark.slow
def test_packed_objects_are_a_clearance_apart_and_in_the_region(pool):
    sample = cg.make_sampler(pile_of(pool, num_objects=6, method="packed", clearance=0.005))
    scenes = jax.jit(jax.vmap(sample))(jax.random.split(jax.random.key(0), 4))
    assert scenes.is_success.all()
    objects = sample.problem.world.objects
    x, y = np.asarray(scenes.region.half_extents[0])
    room = rectangle(-x, -y, x, y)
    for poses, index in zip(scenes.poses, scenes.object_index, strict=True):
        turns = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
        outlines = [
            MultiPoint((objects[k].vertices @ turn.T + pose[:3])[:, :2]).convex_hull
            for k, turn, pose in zip(index, turns, poses, strict=True)
        ]
        gap = np.array([[one.distance(other) for other in outlines] for one in outlines])
        gap = (gap + np.eye(6)).min(1)
        wall = np.array([each.distance(room.exterior) for each in outlines])
        assert all(map(room.contains, outlines))
        assert min(gap.min(), wall.min()) > 0.0045
        # Shoulder to shoulder: each is as near to another, or to a wall, as was asked for.
        assert np.minimum(gap, wall).max() < 0.007
        half = np.array([objects[k].half_extents[2] for k in index])
        assert np.allclose(poses[:, 2], 0.708 + half, atol=1e-3)


def carried(scenes):
    """How many objects of each scene lie on others."""
    return np.asarray((scenes.level > 0) & scenes.is_placed).sum(1)


@pytest.mark.slow
def test_packed_objects_lie_on_others_only_where_that_is_asked_for(pool):
    # Eight that cover nearly 0.9 of the region: not all find room side by side.
    crowded = {
        "num_objects": 8,
        "method": "packed",
        "support": "table",
        "region": "0.19x0.172",
        "repeat": True,
    }
    keys = jax.random.split(jax.random.key(3), 8)
    scenes = jax.jit(jax.vmap(cg.make_sampler(pile_of(pool, **crowded))))(keys)
    assert carried(scenes).max() == 0
    assert scenes.counts.verdicts[:, Verdict.UNRELATED].sum() > 0
    stacked = jax.jit(jax.vmap(cg.make_sampler(pile_of(pool, **crowded, clutter="stack=3"))))(keys)
    assert 0 < carried(stacked).max() <= 3
    assert stacked.is_success.sum() > scenes.is_success.sum()
