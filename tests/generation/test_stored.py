"""A bank as a reset: draws are scenes of the bank, in one model, and they stand there."""

import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.geometry import turn_between
from cluttergen_jax.scene.bank import read_bank
from tests.helpers import banks


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("banks") / "bank"
    banks.write(path, 1)
    return path


@pytest.fixture(scope="module")
def bank(path):
    return cg.load_bank(path)


def test_draws_are_the_banks_own_scenes_that_stand(bank, path):
    scenes = jax.jit(jax.vmap(bank.reset))(jax.random.split(jax.random.key(0), 400))
    stored = {scene.index: scene for scene in read_bank(path).scenes()}
    for row in range(0, 400, 37):
        record = stored[int(scenes.index[row])]
        assert record.is_success
        placed = np.asarray(scenes.is_placed[row])
        names = tuple(bank.names[each] for each in np.asarray(scenes.object_index[row])[placed])
        assert names == record.objects
        translation = np.asarray(scenes.T_world_object.translation()[row])[placed]
        np.testing.assert_allclose(translation, record.poses[:, :3], atol=1e-7)
        np.testing.assert_allclose(
            np.asarray(scenes.T_world_object.rotation().wxyz[row])[placed],
            record.poses[:, 3:],
            atol=1e-6,
        )
    # 400 draws of 192 scenes: nobody is left out for long, and nobody is preferred.
    counts = np.bincount(np.asarray(scenes.index), minlength=256)
    assert len(bank) == 192
    assert (counts[3::4] == 0).all()
    assert (counts > 0).sum() > 140
    assert counts.max() < 12


def test_reset_works_under_vmap_of_vmap_and_scan(bank):
    keys = jax.random.split(jax.random.key(1), 6)
    one = jax.vmap(bank.reset)(keys)
    nested = jax.jit(jax.vmap(jax.vmap(bank.reset)))(keys.reshape(2, 3))
    scanned = jax.lax.scan(lambda carry, key: (carry, bank.reset(key)), 0, keys)[1]
    for a, b, c in zip(*map(jax.tree.leaves, (one, nested, scanned)), strict=True):
        np.testing.assert_array_equal(a, b.reshape(a.shape))
        np.testing.assert_array_equal(a, c)


def test_a_real_scene_stands_in_the_one_model_and_absent_objects_wait(tmp_path):
    banks.two_scenes(tmp_path / "bank")
    bank = cg.load_bank(tmp_path / "bank")
    model = bank.model()
    assert bank.names == ("box", "prism", "tall")
    for place in (0, 1):
        scene = bank.scene(jnp.int32(place))
        data = mujoco.MjData(model)
        data.qpos[:] = scene.qpos
        data.xfrc_applied[:] = scene.xfrc_applied
        start = data.qpos.reshape(-1, 7).copy()
        mujoco.mj_step(model, data, 240)
        poses = data.qpos.reshape(-1, 7)
        np.testing.assert_allclose(poses[:, :3], start[:, :3], atol=2e-3)
        assert turn_between(np, poses[:, 3:], start[:, 3:]).max() < 0.01
        assert np.asarray(scene.is_present).sum() == 2


@pytest.mark.parametrize("batch_size", [1, 50, 1000])
def test_batches_are_the_bank_in_one_model(tmp_path, batch_size):
    with banks.writer(tmp_path / "bank", 600, shard_blocks=2) as writer:
        for block in range(3):
            writer.write_block(block, banks.rows(block, min(256, 600 - 256 * block)))
        writer.finish()
    whole = cg.load_bank(tmp_path / "bank")
    batches = list(itertools.islice(cg.stream_bank(tmp_path / "bank", batch_size), 500))
    assert [len(each) for each in batches[:-1]] == [batch_size] * (len(batches) - 1)
    # One model, so that what is compiled for a batch serves the next.
    assert len({id(each.model()) for each in batches}) == 1
    joined = jax.tree.map(lambda *leaves: np.concatenate(leaves), *batches)
    for one, two in zip(jax.tree.leaves(joined), jax.tree.leaves(whole), strict=True):
        np.testing.assert_array_equal(one, two)
