"""What takes trained checkpoints into scenes/checkpoints: the folder's name, its card, its limits."""

import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pytest

from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.policies.embedded import find_policy
from cluttergen_jax.learning.ppo.checkpoint import save_policy

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("ship_policies", ROOT / "scenes" / "ship_policies.py")
ship_policies = importlib.util.module_from_spec(spec)
spec.loader.exec_module(ship_policies)

CALIBRATION = {
    "number": 4321,
    "share": 0.5,
    "auc": 0.987,
    "brier": 0.04,
    "trust": [0.1],
    "count": [3],
}
GUIDED = {
    "kind": "stability",
    "variant": "guided",
    "config": {"seed": 7, "num_rounds": 6, "num_attempts": 100},
    "network": {},
    "placement": {"max_attempts": 5, "history_stride": 0},
    "num_attempts": 12_345,
    "families": ["mug", "plate"],
    "held_out_families": ["lamp"],
    "held_out": {"stands": CALIBRATION, "robust": CALIBRATION | {"auc": 0.912}},
    "versions": {"cluttergen_jax": "0.1.0", "jax": "0.10.2"},
}


def run_of_guided(folder, width=4):
    """What `train --variant guided` leaves in its folder, but for the attempts."""
    rng = np.random.default_rng(0)
    save_policy(folder / "policy", {"params": {"w": rng.normal(size=width)}}, GUIDED)
    (folder / "policy" / "calibration.png").write_bytes(b"picture")
    return folder


def test_guided_is_shipped_with_its_card(tmp_path):
    folder = ship_policies.ship(run_of_guided(tmp_path / "runs" / "any-name"), tmp_path / "shipped")
    assert folder == tmp_path / "shipped" / "checkpoints" / "guided"
    assert {path.name for path in folder.iterdir()} == {
        "README.md",
        "calibration.png",
        "record.json",
        "weights.npz",
    }
    text = (folder / "README.md").read_text()
    for words in (
        "`python train.py --variant guided --seed 7 --num-attempts 600`",
        "12,345 attempts in 6 rounds",
        "2 families of the modeller: mug, plate",
        "lamp",
        "| stands | 4,321 | 0.500 | 0.987 | 0.040 |",
        "| robust | 4,321 | 0.500 | 0.912 | 0.040 |",
        "cluttergen_jax 0.1.0, jax 0.10.2",
    ):
        assert words in text
    assert read_checkpoint(folder).record["held_out"] == GUIDED["held_out"]


def test_a_policy_is_shipped_with_its_curve(tmp_path):
    shipped = find_policy("policy", "dining")
    shutil.copytree(shipped, tmp_path / "run" / "policy")
    header = "attempts,attempts_per_second,success,num_placed,entropy"
    rows = "100,50,0.5,7.5,-1\n200,50,0.75,8.5,-2\n"
    (tmp_path / "run" / "progress.csv").write_text(f"{header}\n{rows}")
    (tmp_path / "run" / "evaluations.csv").write_text(
        "attempts,success,low95,high95\n100,0.5,0.4,0.6\n"
    )
    folder = ship_policies.ship(tmp_path / "run", tmp_path / "shipped")
    assert folder.name == "dining-policy"
    assert "`python train.py --pool dining --variant policy" in (folder / "README.md").read_text()
    assert (folder / "curve.png").stat().st_size > 1000
    assert (folder / "weights.npz").read_bytes() == (shipped / "weights.npz").read_bytes()
    save_policy(tmp_path / "run" / "policy", {}, {"variant": "policy", "pool": "x"})
    with pytest.raises(SystemExit, match="has not been evaluated"):
        ship_policies.ship(tmp_path / "run", tmp_path / "shipped")
