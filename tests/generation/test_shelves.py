"""Pools of any size: each block of scenes draws some of the objects, nothing is compiled anew for them."""

import pickle
from dataclasses import replace

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax import spec
from cluttergen_jax.assets.pool import Pool, find_pool, write_pool
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.generation.sources import BankSource
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.shelves import draw_shelf

NUM_SCENES = BLOCK_SIZE + 8
ASKED = {"shelf": 4, "num_objects": 2, "method": "clear", "engine": "native"}


@pytest.fixture(scope="module")
def twelve(tmp_path_factory):
    """The path of a pool of twelve objects of three labels."""
    objects = find_pool("dining").objects[:3]
    copies = [
        replace(objects[i % 3], name=f"{objects[i % 3].name}-{i // 3}", label=objects[i % 3].name)
        for i in range(12)
    ]
    path = tmp_path_factory.mktemp("pools") / "twelve"
    return str(write_pool(path, Pool("twelve", tuple(copies))))


@pytest.fixture(scope="module")
def bank(twelve, tmp_path_factory):
    out = tmp_path_factory.mktemp("banks") / "bank"
    return cg.generate(
        out, twelve, num_scenes=NUM_SCENES, seed=5, max_files=4, render=False, **ASKED
    )


@pytest.fixture(scope="module")
def sample(twelve):
    return cg.make_sampler(twelve, **ASKED)


@pytest.fixture(scope="module")
def many():
    """Eight scenes of a sampler, compiled once."""
    return jax.jit(lambda sample, keys: jax.vmap(sample)(keys))


def test_draws_are_even_weighted_and_balanced():
    weights = np.array([1.0, 1, 1, 1, 4, 0])
    keys = jax.random.split(jax.random.key(0), 400)
    drawn = [draw_shelf(key, 2, weights) for key in keys]
    assert drawn == [draw_shelf(key, 2, weights) for key in keys]
    assert all(len(set(each)) == 2 and list(each) == sorted(each) for each in drawn)
    share = np.bincount(np.concatenate(drawn), minlength=6) / len(keys)
    assert share[5] == 0
    # One of weight 4 beside four of weight 1 is among two with the chance 1/2 + 1/2 * 4/7.
    assert abs(share[4] - 11 / 14) < 0.06
    assert np.ptp(share[:4]) < 0.12
    groups = ["a", "a", "a", "a", "b", "c"]
    for key in keys[:50]:
        chosen = draw_shelf(key, 4, np.ones(6), groups)
        assert {4, 5} <= set(chosen)
    with pytest.raises(ConfigError, match="6 of 5 objects"):
        draw_shelf(keys[0], 6, weights)


@pytest.mark.slow
def test_a_scene_is_that_of_its_seed_and_number(bank, sample, many):
    key = jax.random.key(5)
    shelves = []
    for block in (0, 1):
        own = sample.for_block(5, block)
        shelves.append(own.names)
        indices = block * BLOCK_SIZE + np.arange(8)
        keys = jax.vmap(lambda index: jax.random.fold_in(key, index))(indices)
        scenes = jax.device_get(many(own, keys))
        rows = bank.rows(indices.tolist())
        for place, index in enumerate(indices.tolist()):
            row = rows[index]
            placed = scenes.is_placed[place]
            assert row.objects == tuple(
                own.names[each] for each in scenes.object_index[place][placed]
            )
            np.testing.assert_array_equal(row.poses, scenes.poses[place][placed])
    # Surfaces are padded to one of few sizes.
    assert many._cache_size() <= 2
    assert shelves[0] != shelves[1]
    assert [len(names) for names in shelves] == [4, 4]


@pytest.mark.slow
def test_another_shelf_and_the_first_one_again(sample, many):
    keys = jax.random.split(jax.random.key(1), 8)
    first = jax.device_get(many(sample, keys))
    other = sample.reshelve(jax.random.key(7))
    assert other.names != sample.names
    assert other.names == sample.reshelve(jax.random.key(7)).names
    assert jax.device_get(many(other, keys)).is_success.all()
    again = jax.device_get(many(sample, keys))
    np.testing.assert_array_equal(first.poses, again.poses)
    scenes = jax.device_get(many(other, keys))
    assert set(other.scene(scenes, 0).names) <= set(other.names)
    with pytest.raises(ConfigError, match="scenes of another shelf"):
        sample.scene(scenes, 0)
    for call, message in (
        (lambda: jax.vmap(other.reshelve)(keys), "in compiled code"),
        (lambda: other.reshelve(keys), r"keys\[0\]"),
        (lambda: other.for_block(0, -1), "block = -1"),
        (lambda: other.for_block(-1, 0), "seed = -1"),
    ):
        with pytest.raises(ConfigError, match=message):
            call()
    copied = pickle.loads(pickle.dumps(other))
    assert copied.names == other.names
    with pytest.raises(ConfigError, match="a sampler with a shelf"):
        cg.make_sampler("dining", num_objects=2, method="clear").reshelve(keys[0])


@pytest.mark.slow
def test_a_key_gives_the_scene_of_its_shelf(sample, many):
    keys = jax.random.split(jax.random.key(1), 8)
    for own in (sample, sample.reshelve(jax.random.key(7))):
        expected = own.scene(jax.device_get(many(own, keys)), 3)
        alone = own.scene(keys[3])
        assert alone.names == expected.names
        np.testing.assert_allclose(alone.poses, expected.poses, atol=1e-7)


def test_rows_number_objects_as_the_record_does(bank, twelve):
    names = bank.recipe["names"]
    assert names == list(find_pool(twelve).names)
    for table in bank.tables():
        for row in table.to_pylist():
            assert [names[each] for each in row["object_index"]] == row["objects"]
    assert set(bank.object_names) == {name for row in bank.scenes() for name in row.objects}
    assert bank.spec.shelf == 4


@pytest.mark.slow
def test_a_bank_goes_on_and_knows_its_objects(bank, twelve, tmp_path):
    out = tmp_path / "bank"
    cg.generate(out, twelve, num_scenes=40, seed=5, max_files=0, **ASKED)
    longer = cg.generate(out, twelve, num_scenes=NUM_SCENES, seed=5, max_files=0, **ASKED)
    assert longer.table.equals(bank.table)
    assert longer.assets == bank.assets
    pool = find_pool(twelve)
    heavier = tuple(replace(asset, mass=2 * asset.mass) for asset in pool.objects)
    write_pool(twelve_again := tmp_path / "twelve", Pool("twelve", heavier))
    with pytest.raises(BankError, match=r"differ|other"):
        cg.generate(out, str(twelve_again), num_scenes=2 * BLOCK_SIZE + 1, seed=5, **ASKED)


@pytest.mark.slow
def test_everything_takes_such_a_bank(bank, tmp_path):
    loaded = cg.load_bank(bank.path)
    assert len(loaded) == sum(row.is_success for row in bank.scenes())
    assert set(loaded.names) == set(bank.object_names)
    source = BankSource(bank.path)
    names = bank.recipe["names"]
    for number in (1, BLOCK_SIZE + 1):
        again = source.replay(number)
        still = source.still(number)
        ends = {again.names[place]: again.poses[place] for place in again.placed}
        assert list(ends) == sorted(ends, key=names.index)
        np.testing.assert_array_equal([ends[name] for name in still.names], still.poses)
    assert all(cg.verify(bank.path).stands)
    cg.certify(bank.path, seconds=0.1)
    row = cg.read_bank(bank.path).table.slice(BLOCK_SIZE, 1).to_pylist()[0]
    assert {names[i] for i, _ in row["rests_on"]} == set(row["objects"])


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"shelf": 13}, "shelf = 13. Allowed: 1 to 12"),
        ({"shelf": 0}, "shelf = 0. Allowed: 1 to 12"),
        (
            {"shelf": 4, "num_objects": 5},
            "5 objects of a shelf of 4. Allowed: 1 to 4. Try: shelf=10",
        ),
        ({"shelf": 4, "repeat": True}, "`repeat` with a shelf"),
        ({"shelf": 4, "engine": "jax"}, "engine 'jax' with a shelf"),
        ({"shelf": 9, "weights": "mug*=0"}, "shelf = 9. Allowed: 1 to 8"),
        ({"shelf": 4, "balance": "labels"}, "Did you mean 'label'"),
        ({"balance": "label"}, "a shelf of all 12 objects.*balance.*shelf=6"),
        ({"weights": "mug*=2"}, "a shelf of all 12 objects.*weights"),
    ],
)
def test_what_cannot_be_drawn_is_refused(twelve, asked, message):
    with pytest.raises(ConfigError, match=message):
        cg.make_sampler(twelve, **{"num_objects": 2, "method": "clear", **asked})


def test_of_very_many_objects_there_is_a_shelf_unasked(twelve, monkeypatch):
    monkeypatch.setattr(spec, "MOST_ON_SHELF", 8)
    monkeypatch.setattr(spec, "SHELF", 5)
    assert len(cg.make_sampler(twelve, num_objects=2, method="clear").names) == 5
    # Of more objects than that twice as many, as far as a shelf goes.
    assert len(cg.make_sampler(twelve, num_objects=6, method="clear").names) == 8
    with pytest.raises(
        ConfigError, match="1 to 200 objects here; `generate` and `make_sampler` take any"
    ):
        cg.make_env(twelve, num_objects=2)
    left = cg.make_sampler(twelve, exclude=["mug*", "bowl-0"], num_objects=2, method="clear")
    assert {name.split("-")[0] for name in left.names} == {"bowl", "dinner_plate"}
    chosen = cg.make_sampler(twelve, objects=["mug*", "height<0.05"], num_objects=2, method="clear")
    assert {name.split("-")[0] for name in chosen.names} == {"mug", "dinner_plate"}
