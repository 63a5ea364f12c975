"""What pairs and runs of learning refuse: numbers that are none, parts that do not fit, impossible counts."""

import json

import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream.placer.pairs import read_pairs
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.learning.ppo.ppo import PPOConfig
from studies.downstream.suite_folder import DownstreamScale
from studies.perception.api import perception_data, perception_eval, perception_train
from tests.helpers.fuzzed_files import load_pairs, pairs_of, write_pairs
from tests.helpers.records import unsigned


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("target_pose", [float("nan"), 0, 0, 1, 0, 0, 0], "target_pose.*not finite"),
        ("target_pose", [0.0, 0, 0, 2, 0, 0, 0], "quaternion"),
        ("candidate", [[float("inf"), 0, 0, 0]] * 4, "candidate.*not finite"),
        ("candidate", [[0.0, 0, 0, 0]] * 3, "candidate.*as long"),
        ("candidate_verdict", [0, 1, 2, 99], "candidate_verdict.*99"),
        ("standing_poses", [[0.0, 0, 0, 1, 0, 0, 0]], "standing_poses.*as long"),
        ("camera_K", [float("nan")] * 9, "camera_K.*not finite"),
        ("T_region_camera", [1e9] * 16, "T_region_camera"),
        ("width", 1_000_000, "width"),
        ("depth", b"12", "depth.*as long"),
        ("labels", bytes([77] * 12), "labels"),
        ("object", None, "object.*lacks"),
    ],
)
def test_pairs_that_nobody_makes_are_refused(tmp_path, name, value, told):
    """Whole files, with sound checksums: what is in them is looked at, too."""
    rows = pairs_of()
    rows[2][name] = value
    write_pairs(tmp_path, rows)
    with pytest.raises(BankError, match=f"missing or damaged.*{told}"):
        load_pairs(tmp_path)


@pytest.mark.parametrize("number", [10**12, 0, -1, 1.5, "3", None])
def test_a_record_of_impossibly_many_pairs_is_refused_at_once(tmp_path, number):
    write_pairs(tmp_path)
    file = tmp_path / "pairs.json"
    record = unsigned(json.loads(file.read_text()))
    record["splits"]["train"]["num_pairs"] = number
    file.write_text(json.dumps(record))
    with pytest.raises(BankError, match="num_pairs"):
        read_pairs(tmp_path)


HUGE = 10**12


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda folder: cg.placer_data(folder, num_pairs=HUGE), "num_pairs.*10000000"),
        (lambda folder: cg.placer_train(folder, num_pairs=HUGE), "num_pairs.*10000000"),
        (lambda folder: cg.placer_train(folder, num_epochs=HUGE), "num_epochs.*1000000"),
        (lambda folder: cg.placer_eval(folder, num_pairs=HUGE), "num_pairs.*10000000"),
        (lambda folder: perception_data(folder, num_views=HUGE), "num_views.*1000000"),
        (lambda folder: perception_data(folder, num_views=0), "num_views"),
        (lambda folder: cg.placer_data(folder, support="tilted_board_5"), "slopes by 5 degrees"),
        (
            lambda folder: cg.placer_data(folder, spec=cg.SceneSpec(support="rack", surface="all")),
            "2 surf",
        ),
        (lambda folder: perception_data(folder, split="tests"), "split"),
        (lambda folder: perception_data(folder, arm=1.5), "arm"),
        (lambda folder: perception_data(folder, arm=0.0, num_objects=99), "num_objects"),
        (lambda folder: perception_train(folder, num_views=HUGE), "num_views.*1000000"),
        (lambda folder: perception_eval(folder, num_views=HUGE), "num_views.*1000000"),
        (lambda folder: cg.evaluate(trials=HUGE), "trials.*1000000"),
        (lambda folder: cg.generate(folder, num_scenes=HUGE), "num_scenes.*2000000000"),
        (lambda folder: DownstreamScale(num_pairs=HUGE), "num_pairs.*10000000"),
        (lambda folder: DownstreamScale(trials=HUGE), "trials.*1000000"),
        (lambda folder: PPOConfig(num_attempts=HUGE), "num_attempts.*10,000,000,000"),
        (lambda folder: cg.pretrain(out=folder, num_shapes=HUGE), "num_shapes.*1000000"),
    ],
)
def test_what_cannot_be_meant_is_refused_at_once(tmp_path, call, told):
    with pytest.raises(ConfigError, match=told):
        call(tmp_path / "out")
