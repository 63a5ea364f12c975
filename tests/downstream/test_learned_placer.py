"""A placer learns from pairs what stands: one object to be placed beside another, on a small table."""

import pytest

from cluttergen_jax import placer_data, placer_eval, placer_train
from cluttergen_jax.downstream.placer.proposers import find_placer
from cluttergen_jax.downstream.placer.scored import ScoredPlacer

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
