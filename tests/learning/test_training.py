"""Training runs: they leave what they promise, are taken up again, and their policies generate scenes."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.policies.policy import load_policy
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training import run_logger
from cluttergen_jax.learning.training.run_logger import read_rows
from cluttergen_jax.placement.observation import ObservationConfig, observe
from tests.helpers.problems import made_up_rules
from tests.helpers.runs import Stopping, make_run, weights


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "whole"
    return folder, make_run(folder).train()


def test_leaves_progress_curve_and_checkpoints(trained):
    folder, _ = trained
    rows = read_rows(folder / "progress.csv")
    assert [row["attempts"] for row in rows] == [16, 32, 48, 64]
    assert (folder / "curve.png").stat().st_size > 1000
    assert read_record(folder / "last")["num_updates"] == 4
    for name in ("policy", "best"):
        assert read_record(folder / name)["kind"] == "pose"
        assert (folder / name / "weights.npz").exists()
    assert list((folder / "tensorboard").iterdir())


@pytest.mark.slow
def test_stopped_run_goes_on_to_the_same_bits(trained, tmp_path):
    folder = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        make_run(folder).train(interrupt=Stopping(2))
    assert 0 < read_record(folder / "last")["num_updates"] < 4
    state = make_run(folder).train()
    np.testing.assert_array_equal(weights(state), weights(trained[1]))
    assert [row["update"] for row in read_rows(folder / "progress.csv")] == [0, 1, 2, 3]
    assert read_record(folder / "best")["success"] == read_record(trained[0] / "best")["success"]


def test_a_run_that_was_killed_before_its_policy_was_stored_gets_one(trained, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    shutil.rmtree(folder / "policy")
    make_run(folder).train()
    assert read_record(folder / "policy") == read_record(trained[0] / "policy")


def test_a_run_that_was_killed_while_its_curve_was_drawn_draws_it(trained, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder)
    shutil.rmtree(folder / "policy")
    (folder / "curve.png").unlink()

    def killed(*args):
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(run_logger, "draw_curve", killed)
        with pytest.raises(SystemExit):
            make_run(folder).train()
    make_run(folder).train()
    assert (folder / "curve.png").is_file()
    assert read_record(folder / "policy") == read_record(trained[0] / "policy")


def test_policy_reads_back_and_acts(trained):
    folder, state = trained
    rules = made_up_rules(history_stride=12)
    policy = load_policy(read_checkpoint(folder / "policy"), rules, is_sampled=False)
    episode = rules.begin(jax.random.key(0))
    action = jax.jit(policy)(jax.random.key(1), episode)
    assert action.shape == (4,)
    assert ((action > 0) & (action < 1)).all()
    # Stored at half precision, and without the critic: everything else comes back.
    pairs = jax.tree.leaves_with_path(
        jax.tree.map(lambda a, b: jnp.abs(a - b).max(), policy.params, state.params)
    )
    changed = {jax.tree_util.keystr(path).split("'")[3] for path, change in pairs if change > 1e-3}
    assert changed <= {"critic", "value"}

    @jax.jit
    def mean_of(params, episode):
        seen = jax.tree.map(lambda leaf: leaf[None], observe(rules, episode, ObservationConfig()))
        return policy.agent.apply(params, seen)[0].mean()[0]

    np.testing.assert_allclose(action, mean_of(state.params, episode), atol=0.01)
