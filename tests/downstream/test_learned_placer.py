"""A placer learns from pairs what stands: one object to be placed beside another, on a small table."""

import numpy as np
import pytest

from cluttergen_jax import placer_data, placer_eval, placer_train
from cluttergen_jax.downstream.placer.heads.scored import ScoredPlacer
from cluttergen_jax.downstream.placer.pairs.store import load_queries
from cluttergen_jax.downstream.placer.proposers import find_placer
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.sensing.noise import NOISE_OFF, REALSENSE

pytestmark = pytest.mark.slow
SCENES = {"pool": "household", "support": "table-0.40x0.30", "num_objects": 2, "method": "random"}


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("placer") / "pairs"
    placer_data(folder, num_scenes=160, num_pairs=256, **SCENES)
    placer_data(folder, num_scenes=80, num_pairs=120, split="test", **SCENES)
    return folder


def test_a_trained_placer_beats_chance(pairs, tmp_path):
    told = []
    folder = placer_train(pairs, "scored", tmp_path / "run", num_epochs=6, seed=1, show=told.append)
    # There is no validation split: every tenth scene was held out.
    assert any(line.startswith("validation") for line in told)
    assert isinstance(find_placer(folder), ScoredPlacer)
    found = placer_eval(pairs, ("random", str(folder)), noise=(0.0,), seed=2)
    shares = {row["trial"]["placer"]: row["figures"]["success"] for row in found.rows}
    chance, learned = (shares[name] for name in ("random", str(folder)))
    assert learned["low95"] > chance["high95"]
    assert learned["share"] > 0.9


def test_noises_take_turns(pairs):
    noises = {"off": NOISE_OFF, "on": REALSENSE, "both": (NOISE_OFF, REALSENSE)}
    seen = {
        name: load_queries(pairs, noise, 3, "test", 8)[0].heights.height for name, noise in noises.items()
    }
    np.testing.assert_array_equal(seen["both"][::2], seen["off"][::2])
    np.testing.assert_array_equal(seen["both"][1::2], seen["on"][1::2])
    assert np.abs(seen["off"] - seen["on"]).max() > 1e-3


def test_options_that_do_not_fit_are_refused(pairs, tmp_path):
    with pytest.raises(ConfigError, match="256"):
        placer_train(pairs, out=tmp_path, num_pairs=10_000)
    with pytest.raises(ConfigError, match="`encoder_weights`"):
        placer_train(pairs, out=tmp_path, encoder_weights=tmp_path)
