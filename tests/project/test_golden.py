"""What an earlier version wrote still opens: pools, supports, banks, checkpoints (tests/golden/README.md)."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.pool import read_pool
from cluttergen_jax.assets.support_file import read_support, support_hash
from cluttergen_jax.judging.verify import scene_files, verify_scene
from cluttergen_jax.learning.methods import proposer_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.policies.embedded import list_policies
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.scene.bank import read_bank

GOLDEN = Path(__file__).parents[1] / "golden"
# Banks know their objects and their support by these.
HASHES = {
    "block": "c5bd66ce5ef96cb98a42d215e49c9923b1149477644626d2abe7047338194a66",
    "can": "c29676fd5ea993273d19c1b7b6b907816e2e4a6640475c3db01508067032d4e9",
}
SUPPORT_HASH = "c23d47c465efac716c1739581845d32bdbb936704da4f60632ef0b911af9b888"


@pytest.fixture(scope="module")
def problem():
    return make_problem(ProblemConfig(placement=PlacementConfig(num_objects=1, history_stride=12)))


def test_a_pool_reads_as_it_was_written():
    pool = read_pool(GOLDEN / "pool")
    assert pool.names == ("block", "can")
    np.testing.assert_allclose(pool["block"].half_extents, (0.04, 0.025, 0.02), atol=1e-6)
    assert pool["block"].mass == pytest.approx(0.08 * 0.05 * 0.04 * 500, rel=1e-3)
    np.testing.assert_allclose(
        pool["can"].pieces[0].rgba, (200 / 255, 60 / 255, 40 / 255, 1), atol=1e-3
    )
    assert {asset.name: object_hash(asset) for asset in pool.objects} == HASHES


def test_a_support_reads_as_it_was_written():
    support = read_support(GOLDEN / "support")
    assert support.top == pytest.approx(0.04)
    np.testing.assert_allclose(support.region.half_extents, (0.35, 0.25))
    assert support_hash(support) == SUPPORT_HASH


def test_a_bank_reads_stands_and_resets():
    bank = read_bank(GOLDEN / "bank")
    assert bank.table["is_success"].to_pylist() == [True] * 4
    stored = pq.read_table(GOLDEN / "bank" / "scenes-000000.parquet")["poses"].to_pylist()
    assert bank.table["poses"].to_pylist() == stored
    scene = cg.load_bank(GOLDEN / "bank").scene(1)
    np.testing.assert_array_equal(
        scene.T_world_object.translation(), np.array(stored[1], np.float32)[:, :3]
    )
    assert all(verify_scene(path).stands for path in scene_files(bank.path))


@pytest.mark.parametrize("name", sorted(list_policies()))
def test_a_shipped_checkpoint_loads(name, problem):
    checkpoint = read_checkpoint(list_policies()[name])
    assert checkpoint.kind == ("stability" if name == "guided" else "pose")
    assert proposer_of(checkpoint.variant, checkpoint, problem.rules) is not None
