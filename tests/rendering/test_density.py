"""Heat maps of proposals: which cell is which, and that pictures colour the right part of the table."""

from dataclasses import replace

import numpy as np
import pytest

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.rendering.figure import density_figure
from cluttergen_jax.rendering.scene_renderer import PictureConfig
from tests.helpers.drawing import needs_gl
from tests.helpers.recordings import cubes

PICTURE = PictureConfig(width=160, height=120, samples=2)


def proposals(x, y, number=400):
    """Actions near one place of the region."""
    spread = np.random.default_rng(0).normal(0, 0.02, (number, 4))
    return np.clip(np.array([x, y, 0.2, 0.5]) + spread, 0, 1).astype(np.float32)


def proposed(x, y):
    """`cubes`, everything proposed near one place of a turned region."""
    attempts = tuple(replace(each, proposals=proposals(x, y)) for each in cubes().attempts)
    return replace(cubes(), attempts=attempts, region=Rectangle((0.02, 0.0), (0.12, 0.08), 0.3))


@needs_gl
def test_the_figure_colours_the_table_there_and_nothing_else():
    right, left = (
        density_figure(proposed(x, 0.1), picture=PICTURE).astype(int) for x in (0.9, 0.1)
    )
    # Violet on a brown table takes red away.
    where = {
        name: np.argwhere(change > 25)
        for name, change in (("right", (left - right)[..., 0]), ("left", (right - left)[..., 0]))
    }
    assert min(map(len, where.values())) > 20
    assert where["right"][:, 1].mean() > where["left"][:, 1].mean() + 20
    # Elsewhere the two pictures are one.
    assert (np.abs(right - left).max(-1) > 2).mean() < 0.25
    with pytest.raises(ConfigError, match="num_proposals"):
        density_figure(cubes(), picture=PICTURE)
    with pytest.raises(ConfigError, match="no attempt"):
        density_figure(replace(cubes(), attempts=()), picture=PICTURE)
