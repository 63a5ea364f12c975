"""The ready scenes in `scenes/ready`: each opens in plain MuJoCo and stands."""

from pathlib import Path

import mujoco
import pytest

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.judging.verify import verify_scene

READY = Path(__file__).parents[2] / "scenes" / "ready"


@pytest.mark.parametrize("pool", EMBEDDED)
def test_a_ready_scene_of_each_pool_stands(pool):
    model = mujoco.MjModel.from_xml_path(str(READY / f"{pool}.xml"))
    assert (model.njnt, model.nkey) == (10, 1)
    assert verify_scene(READY / f"{pool}.xml").stands
