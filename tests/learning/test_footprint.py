"""Features of footprints: shares of its footprint, counted here point by point and there by a transform."""

import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.learning.agents import FootprintFeatures

CELL = 0.01
SIDE = 48 * CELL
PLATE = (0.08, 0.02)
BLOCK = (0.03, 0.03)


def cloud_of(half, middle=(0.0, 0.0)) -> np.ndarray:
    """f32[1024, 3]: a flat sheet in no order, at the object's middle height."""
    line = np.linspace(-1, 1, 32)
    grid = np.stack(np.meshgrid(line, line, indexing="ij"), -1).reshape(-1, 2) * half + middle
    return np.random.default_rng(0).permutation(np.c_[grid, np.zeros(1024)]).astype(np.float32)


def observation(at=(0.1, -0.05, 0.02), turn=0.0, half=(0.24, 0.24)):
    """The plate is the current object; the block stands at `at`, turned."""
    pose = jnp.array([*at, np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)])
    return {
        "region": jnp.array([*half, 0.3]),
        "focus": jnp.int32(0),
        "is_placed": jnp.array([False, True]),
        "T_region_object": jnp.zeros((2, 7)).at[1].set(pose),
    }


@pytest.fixture(scope="module")
def room():
    return FootprintFeatures.of(jnp.array([cloud_of(PLATE), cloud_of(BLOCK)]), SIDE, 12, 4)


@pytest.mark.parametrize(("height", "is_in_the_way"), [(0.02, False), (0.07, True)])
def test_what_is_lower_than_an_underside_is_not_in_its_way(height, is_in_the_way):
    """The pan's handle is 5 cm up; the block's top is at `height`, in the middle of the region."""
    pan = cloud_of((0.03, 0.03), (-0.1, 0.0))
    handle = cloud_of((0.08, 0.01), (0.05, 0.0))
    handle[:, 2] += 0.05
    held = np.concatenate([pan, handle])
    block = np.tile(cloud_of(BLOCK), (2, 1))
    # Turned by 45 degrees; once the handle's middle is over the block, once the pan itself.
    line = (np.arange(12) + 0.5) / 12 * SIDE - SIDE / 2
    spots = {"handle": (-0.035, -0.035), "pan": (0.07, 0.07)}
    for undersides in (False, True):
        room = FootprintFeatures.of(jnp.array([held, block]), SIDE, 12, 4, 1, undersides)
        shares = np.asarray(room(observation(at=(0.0, 0.0, height))))[..., 0, 0]
        for spot, (x, y) in spots.items():
            share = shares[np.abs(line - x).argmin(), np.abs(line - y).argmin()]
            if undersides and spot == "handle" and not is_in_the_way:
                assert abs(share) < 1e-5
            else:
                assert share > 0.1
