"""The stability network: what it reads, how it is fitted, how far its trust holds, and a small training."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.learning.methods import proposer_of
from cluttergen_jax.learning.policies.checkpoint import read_checkpoint
from cluttergen_jax.learning.policies.guided import (
    NUM_FEATURES,
    StabilityNet,
    StabilityNetConfig,
    blank_params,
    features_of,
    load_guided,
    make_guided,
)
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.training import guided
from cluttergen_jax.learning.training.guided import (
    Examples,
    Explorer,
    StabilityFitConfig,
    begin,
    calibration,
    collect_step,
    draw_calibration,
    fit,
    predictions_of,
)
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.methods.baselines import LowestFit
from cluttergen_jax.placement.problem import ProblemConfig, make_problem

SMALL = StabilityNetConfig(width=16)
RECORD = {
    "kind": "stability",
    "variant": "guided",
    "network": dataclasses.asdict(SMALL),
    "placement": {"max_attempts": 5, "history_stride": 0},
}


@pytest.fixture(scope="module")
def rules():
    placement = PlacementConfig(num_objects=4, history_stride=0, min_margin=0.003)
    objects = ("mug", "bowl", "soup_can", "cereal_box")
    return make_problem(
        ProblemConfig(objects=objects, support="table-0.30x0.30", placement=placement)
    ).rules


def made_up(number, seed=0):
    """Examples whose outcome follows from two features, but for noise."""
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(number, NUM_FEATURES)).astype(np.float32)
    stands = features[:, 0] + 0.5 * features[:, 3] + 0.1 * rng.normal(size=number) > 0.0
    return Examples(
        features=features,
        stands=stands,
        is_robust=stands & (features[:, 1] > 0),
        knows_robust=np.ones(number, bool),
        disturbs=~stands & (features[:, 2] > 0),
        shift=np.where(stands, 0.0, 0.05).astype(np.float32),
        margin=(0.01 * features[:, 4]).astype(np.float32),
        is_on=features[:, 5] > 0,
    )


@pytest.mark.slow
def test_a_fit_learns_what_can_be_learned_and_equal_seeds_fit_alike():
    examples = made_up(10_000)
    fresh = made_up(2000, seed=1)
    params, loss = fit(SMALL, StabilityFitConfig(num_epochs=12), examples, seed=0)
    assert np.isfinite(loss)
    predicted = predictions_of(SMALL, params, fresh)
    stands = calibration(predicted.stands, fresh.stands, fresh.is_on)
    robust = calibration(predicted.is_robust, fresh.is_robust, fresh.is_on)
    assert stands.auc > 0.95
    assert robust.auc > 0.95
    assert stands.precision > 0.9
    again, _ = fit(SMALL, StabilityFitConfig(num_epochs=12), examples, seed=0)
    jax.tree.map(np.testing.assert_array_equal, params, again)


def test_blank_parameters_are_those_that_the_network_begins_with_but_for_their_values():
    for network in (StabilityNetConfig(), StabilityNetConfig(width=8, depth=3)):
        begun = StabilityNet(network).init(jax.random.key(0), jnp.zeros((1, NUM_FEATURES)))
        blank = blank_params(network)
        assert jax.tree.structure(blank) == jax.tree.structure(begun)
        for ours, theirs in zip(jax.tree.leaves(blank), jax.tree.leaves(begun), strict=True):
            assert (ours.shape, ours.dtype) == (theirs.shape, theirs.dtype)


def test_calibration_counts_what_stood(tmp_path):
    logits = np.array([-5.0, -5.0, 0.05, 5.0, 5.0, 5.0], np.float32)
    stood = np.array([False, True, True, True, True, False])
    found = calibration(logits, stood, np.array([True] * 3 + [False] * 3))
    assert found.count == (2, 0, 0, 0, 0, 1, 0, 0, 0, 3)
    assert found.stood[0] == 0.5
    assert found.stood[-1] == pytest.approx(2 / 3)
    assert found.precision == pytest.approx(2 / 3)
    # Of the four that stood and the two that fell: pairs in the right order, ties half.
    assert found.auc == pytest.approx((0.5 + 0 + 1 + 0 + 1 + 0.5 + 1 + 0.5) / 8)
    draw_calibration({"stands": found}, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 5000


def test_features_are_finite_and_know_neither_the_object_nor_its_number(rules):
    placer = make_guided(rules, SMALL, blank_params(SMALL))
    episode = rules.begin(jax.random.key(0))

    @jax.jit
    def read(rules, placer, episode):
        return features_of(rules, episode, placer.candidates(jax.random.key(1), episode))

    features = np.asarray(read(rules, placer, episode))
    assert features.shape == (96, NUM_FEATURES)
    assert np.isfinite(features).all()
    assert np.abs(features).max() < 10
    # The same object under another number is the same to the network.
    other = dataclasses.replace(
        rules,
        geometry=jax.tree.map(
            lambda leaf: leaf[::-1] if jnp.shape(leaf)[:1] == (4,) and jnp.ndim(leaf) else leaf,
            rules.geometry,
        ).replace(surface_owner=3 - rules.geometry.surface_owner, boxes=rules.geometry.boxes),
    )
    swapped = episode.replace(object_index=3 - episode.object_index)
    placer = make_guided(other, SMALL, blank_params(SMALL))
    again = read(other, placer, swapped)
    np.testing.assert_allclose(features, again, atol=1e-5)


@pytest.mark.slow
def test_attempts_are_labelled_with_what_the_rules_said(rules):
    explorer = Explorer(
        LowestFit(rules), params=blank_params(SMALL), network=SMALL, exploration=np.float32(1)
    )
    episodes = begin(explorer, jax.random.key(0), 16)
    step = jax.jit(collect_step)
    seen = []
    for _ in range(6):
        episodes, row = step(explorer, episodes)
        seen.append(jax.device_get(row))
    rows = jax.tree.map(lambda *parts: np.concatenate(parts), *seen)
    assert rows.features.shape == (96, NUM_FEATURES)
    assert np.isfinite(rows.features).all()
    # Everything is tried: some stand, some fall, and whatever moved another does not stand.
    assert 0.1 < rows.stands.mean() < 0.99
    assert not (rows.stands & rows.disturbs).any()
    # Nothing asked about robustness: only of what fell is it known.
    np.testing.assert_array_equal(rows.knows_robust, ~rows.stands)
    assert not rows.is_robust[rows.knows_robust].any()
    assert np.all(rows.margin[rows.stands] >= 0.002)


def test_a_stored_network_places_as_before(rules, tmp_path):
    params, _ = fit(SMALL, StabilityFitConfig(num_epochs=1), made_up(512), seed=0)
    save_policy(tmp_path, params, RECORD)
    checkpoint = read_checkpoint(tmp_path)
    stored = load_guided(checkpoint, rules)
    episode = rules.begin(jax.random.key(0))
    half = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float16).astype(jnp.float32), params)
    jax.tree.map(np.testing.assert_array_equal, stored.params, half)
    propose = proposer_of("guided", checkpoint, rules)
    poses = [jax.jit(each)(jax.random.key(2), episode) for each in (propose, stored)]
    np.testing.assert_array_equal(*poses)
    assert not stored.is_robust


TINY = guided.GuidedConfig(
    network=SMALL,
    num_rounds=2,
    num_settings=2,
    num_attempts=64,
    num_episodes=8,
    num_variants=50,
    num_held_out=50,
)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_training_can_be_stopped_and_taken_up_and_ends_alike(home, tmp_path):
    whole = tmp_path / "whole"
    parts = tmp_path / "parts"
    lines = []
    policy = guided.GuidedTraining(TINY, whole, lines.append).run()
    assert sum(line.startswith("round") for line in lines) == 2
    files = sorted(path.name for path in (whole / "attempts").iterdir())
    assert files == [
        "00-00.npz",
        "00-01.npz",
        "01-00.npz",
        "01-01.npz",
        "held-out-00.npz",
        "held-out-01.npz",
    ]
    record = json.loads((policy / "record.json").read_text())
    assert record["num_attempts"] == 128
    assert record["held_out"]["stands"]["number"] == 16
    assert not set(record["families"]) & set(record["held_out_families"])
    assert (policy / "weights.npz").stat().st_size < 200_000
    assert (policy / "calibration.png").exists()

    class Stopped(guided.GuidedTraining):
        def _collect(self, *arguments):
            if len(list((self.folder / "attempts").iterdir())) == 3:
                raise KeyboardInterrupt
            return super()._collect(*arguments)

    with pytest.raises(KeyboardInterrupt):
        Stopped(TINY, parts, lines.append).run()
    assert not (parts / "policy").exists()
    guided.GuidedTraining(TINY, parts, lines.append).run()
    with (
        np.load(whole / "policy/weights.npz") as one,
        np.load(parts / "policy/weights.npz") as other,
    ):
        for name in one.files:
            np.testing.assert_array_equal(one[name], other[name])
    with pytest.raises(ConfigError, match="another config"):
        guided.GuidedTraining(dataclasses.replace(TINY, exploration=0.5), whole, lines.append)
    (whole / "attempts" / "00-01.npz").write_bytes(b"half of it")
    with pytest.raises(PoolError, match=r"00-01\.npz cannot be read"):
        guided.GuidedTraining(TINY, whole, lines.append).run()
