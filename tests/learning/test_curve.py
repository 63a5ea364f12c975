"""The training curve shows what there is, at the edges too; and what `--help` says is embedded is there."""

import inspect

import numpy as np
import pytest
from PIL import Image

from cluttergen_jax.api.generate import generate
from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.config import VARIANTS
from cluttergen_jax.evaluation.api import evaluate
from cluttergen_jax.generation.sampler import make_sampler
from cluttergen_jax.learning.policies.embedded import list_policies
from cluttergen_jax.learning.training.metrics_log import draw_curve


def num_blue(path):
    """In each third of the picture, pixels of the line's colour."""
    image = np.asarray(Image.open(path).convert("RGB")).astype(int)
    is_blue = (np.abs(image - np.array([31, 119, 180])).max(-1) < 60).sum(0)
    return [int(part.sum()) for part in np.array_split(is_blue, 3)]


@pytest.mark.parametrize("success", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("number", [1, 20])
def test_no_panel_of_the_curve_is_empty(tmp_path, success, number):
    rows = [
        {"attempts": 1000.0 * each, "success": success, "num_placed": 10.0, "entropy": 1.0}
        for each in range(1, number + 1)
    ]
    draw_curve(rows, tmp_path / "curve.png", "test")
    seen = num_blue(tmp_path / "curve.png")
    # A line at the edge is not half hidden by the frame.
    assert min(seen) > 0.8 * max(seen) > 0


def test_what_is_not_embedded_is_said_where_it_is_offered():
    there = set(list_policies())
    missing = [
        each
        for each in VARIANTS
        if each != "guided" and not there.issuperset(f"{pool}-{each}" for pool in EMBEDDED)
    ]
    assert missing == ["beta"]
    for function in (generate, make_sampler, evaluate):
        text = " ".join((inspect.getdoc(function) or "").split())
        assert 'or "beta", of which none is embedded' in text, function
