"""Imported objects stand as people put them; another pose can be chosen, in the pool."""

import numpy as np
import pytest
import trimesh

import cluttergen_jax
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import PoolError


@pytest.fixture
def lying(tmp_path, monkeypatch):
    """A carton that lies on its side in its file."""
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    # As of an object that is not among the few hundred that are kept.
    monkeypatch.setattr("cluttergen_jax.assets.pool._KEPT", 0)
    trimesh.creation.box((0.07, 0.2, 0.07)).export(tmp_path / "carton.obj")
    return tmp_path / "carton.obj"


def test_what_lies_in_its_file_stands_in_the_pool_and_can_be_laid_down_again(lying, capsys):
    line = ["import", str(lying), "--pool", "mine", "--trials", "8", "--jobs", "1", "--no-progress"]
    assert main(line) == 0
    told = capsys.readouterr().out
    assert "carton: turned by 90 degrees, as people put it: 200 mm tall" in told
    assert "cluttergen pool pose" in told
    before = find_pool("mine")
    assert before["carton"].half_extents == pytest.approx([0.035, 0.035, 0.1], abs=1e-4)
    assert main(["pool", "pose", "mine", "carton"]) == 0
    assert "0 (now)      200" in capsys.readouterr().out
    lower = next(
        k for k, pose in enumerate(cluttergen_jax.pool_poses("mine", "carton")) if pose.height < 0.1
    )
    assert main(["pool", "pose", "mine", "carton", str(lower)]) == 0
    assert "70 mm tall, stable in 100.0 % of trials" in capsys.readouterr().out
    pool = find_pool("mine")
    asset = pool["carton"]
    assert pool.hash != before.hash
    assert asset.half_extents[2] == pytest.approx(0.035, abs=1e-4)
    assert asset.mass == before["carton"].mass
    assert np.ptp(asset.cloud[:, 2]) == pytest.approx(0.07, abs=0.002)
    assert np.ptp(asset.pieces[0].mesh.vertices[:, 2]) == pytest.approx(0.07, abs=1e-4)
    assert asset.resting[0].height == pytest.approx(0.035, abs=1e-4)
    assert asset.quality.solo_rate == 1.0
    assert cluttergen_jax.pool_poses("mine", "carton")[0].height == pytest.approx(0.07, abs=1e-4)
    with pytest.raises(PoolError, match="0 to"):
        cluttergen_jax.set_pose("mine", "carton", 99)
