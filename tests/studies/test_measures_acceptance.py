"""Acceptance bias: hand arithmetic, identities, and intervals that cover what they should."""

import numpy as np

from cluttergen_jax.assets.support import Rectangle
from studies.measures.acceptance import acceptance_bias, bias_of, zone_of

REGION = Rectangle((0.0, 0.0), (0.3, 0.35), 0.0)


def test_lift_by_hand():
    category = np.array([0] * 6 + [1] * 4)
    passed = np.array([1, 0, 0, 0, 0, 0, 1, 1, 1, 0], bool)
    bias = bias_of("kind", category, ("a", "b", "none"), passed, np.arange(10))
    assert bias.proposed.tolist() == [6, 4, 0]
    assert bias.passed.tolist() == [1, 3, 0]
    np.testing.assert_allclose(bias.lift[:2], [(1 / 4) / (6 / 10), (3 / 4) / (4 / 10)])
    assert np.isnan([bias.lift[2], bias.low[2], bias.high[2]]).all()


def test_intervals_cover_the_truth():
    rng = np.random.default_rng(1)
    covered = 0
    for seed in range(100):
        category = rng.integers(0, 2, 300)
        # Whole scenes pass or fail: thirty scenes of ten candidates each, without any bias.
        scene = np.arange(300) // 10
        passed = (rng.random(30) < 0.5)[scene]
        bias = bias_of("kind", category, "ab", passed, scene, num_draws=200, seed=seed)
        covered += bias.low[0] <= 1 <= bias.high[0]
    assert 86 <= covered <= 100


def test_four_sortings():
    rng = np.random.default_rng(4)
    num = 400
    slot = rng.integers(0, 3, num)
    index = rng.integers(0, 2, num)
    positions = rng.uniform(-1, 1, (num, 2)) * REGION.half_extents
    passed = zone_of(positions, REGION) == 0
    found = acceptance_bias(
        ["mug", "bowl"],
        index,
        positions,
        rng.uniform(0, 6.28, num),
        slot,
        passed,
        np.arange(num),
        REGION,
    )
    assert {name: len(bias.labels) for name, bias in found.items()} == {
        "object": 2, "zone": 2, "yaw": 8, "order": 3
    }  # fmt: skip
    assert found["zone"].under_represented == ("edge",)
    assert found["zone"].lift[1] == 0
    assert found["object"].under_represented == ()
    assert found["yaw"].labels[1] == "45-90 deg"
    assert all(bias.proposed.sum() == num for bias in found.values())
