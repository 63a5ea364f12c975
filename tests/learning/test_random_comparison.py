"""Every training ends beside `random`; the paper's way by one argument."""

import pytest

from cluttergen_jax import train
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training import pretrain
from cluttergen_jax.learning.training.run_logger import comparison_lines, difference_interval
from cluttergen_jax.learning.training.train import TrainConfig, as_in_paper
from cluttergen_jax.statistics import wilson


def rate(share, trials=256):
    low, high = wilson(round(share * trials), trials)
    return {
        "success": round(share * trials) / trials,
        "low95": low,
        "high95": high,
        "episodes": trials,
    }


def told(policy, random, curve, training_success=None):
    rows = [{"success": each, "attempts": 3200.0 * (k + 1)} for k, each in enumerate(curve)]
    known = {"random": rate(random), "training_success": training_success or policy}
    return " ".join(comparison_lines(rate(policy) | known, rows))


def test_the_interval_of_a_difference():
    # Newcombe (1998), table II: 56/70 and 48/80, method 10.
    low, high = difference_interval(rate(56 / 70, 70), rate(48 / 80, 80))
    assert (low, high) == pytest.approx((0.0524, 0.3339), abs=2e-4)
    assert (
        difference_interval(rate(0.5), rate(0.5))[0]
        < 0
        < difference_interval(rate(0.5), rate(0.5))[1]
    )


def test_a_policy_that_is_better_needs_no_advice():
    assert "better by 0.1" in told(0.7, 0.5, [0.7] * 20)
    assert "advice" not in told(0.7, 0.5, [0.7] * 20)


@pytest.mark.parametrize(
    ("policy", "random", "curve", "training_success", "said"),
    [
        (0.512, 0.461, [0.3] * 10 + [0.4] * 10 + [0.5] * 10, None, "not better; .* still rises"),
        (0.512, 0.461, [0.5] * 40, None, "not better; .* fewer objects"),
        (0.30, 0.46, [0.5] * 40, 0.6, "worse; .* short check"),
        (0.98, 0.98, [0.9] * 40, None, "not better; .* fills this world"),
        (0.1, 0.2, [0.1] * 3, None, "9,600 make 3 updates"),
    ],
)
def test_what_is_not_better_is_said_with_what_is_missing(
    policy, random, curve, training_success, said
):
    lines = told(policy, random, curve, training_success)
    for part in said.split(" .* "):
        assert part in lines


def test_the_papers_way_takes_an_encoder_of_its_preset(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        pretrain, "pretrain_for", lambda network, folder, show: asked.append((network, folder))
    )
    said = []
    config = as_in_paper(TrainConfig(out=str(tmp_path / "run")), said.append)
    assert (config.preset, config.variant) == ("paper_cpu", "beta_free")
    assert asked[0][0].scene_encoder == "pointnet"
    assert config.encoder_weights == str(tmp_path / "encoder-pointnet-256-256") == str(asked[0][1])
    assert said == ["paper      preset paper_cpu, variant beta_free"]
    given = TrainConfig(preset="paper_code", variant="open_loop", encoder_weights="mine")
    assert as_in_paper(given, said.append) == given
    with pytest.raises(ConfigError, match="leaving preset out"):
        as_in_paper(TrainConfig(preset="gpu"))
    with pytest.raises(ConfigError, match="paper = True with variant 'guided'"):
        train(paper=True, variant="guided")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_run_of_the_papers_way(tmp_path):
    said = []
    asked = {"num_objects": 2, "num_attempts": 20_000, "eval_episodes": 64}
    policy = train(paper=True, out=tmp_path / "run", show=said.append, **asked)
    record = read_record(policy)
    assert (record["preset"], record["variant"]) == ("paper_cpu", "beta_free")
    assert record["attempts"] >= 20_000
    evaluation = record["evaluation"]
    assert evaluation["episodes"] == evaluation["random"]["episodes"] == 64
    assert 0 < evaluation["random"]["success"] <= 1
    assert read_record(tmp_path / "encoder-pointnet-256-256")["held_out_accuracy"] > 0.5
    (line,) = [each for each in said if each.startswith("random ")]
    assert "in the same world (64 episodes): the policy is" in line
