"""Heads of placers: what they read, that they learn, what they propose, how they are stored and refused."""

import dataclasses
import functools
import json

import jax
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream import fitting
from cluttergen_jax.downstream.fitting import FitConfig
from cluttergen_jax.downstream.placer import training
from cluttergen_jax.downstream.placer.map_search import APART
from cluttergen_jax.downstream.placer.query import NUM_PROPOSALS
from cluttergen_jax.downstream.placer.scored import (
    MIRRORED,
    ScoredConfig,
    ScoredHead,
    crops_of,
    features_of,
    load_placer,
    lower_candidates,
    own_shape,
    placer_folder,
)
from cluttergen_jax.downstream.placer.training import PlacerTraining, best_temperature
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from tests.helpers.queries import HALF, made_up_examples, made_up_query

HEADS = {
    "scored": ScoredHead(ScoredConfig(8, 16, 16, 32, 16, 4, 2)),
}


features_of = jax.jit(features_of)
crops_of = jax.jit(crops_of)
own_shape = jax.jit(own_shape)
lower_candidates = jax.jit(lower_candidates)


@pytest.fixture(scope="module")
def examples():
    return made_up_examples(8)


@jax.jit
def answered(placer, keys, queries):
    return jax.vmap(placer)(keys, queries)


def proposed(placer, examples):
    """What a placer proposes for three queries."""
    queries = jax.tree.map(lambda leaf: leaf[:3], examples.query)
    return answered(placer, jax.random.split(jax.random.key(0), 3), queries)


def pose_at(*poses):
    return np.array(poses, np.float32)


# What is read


def turned(query):
    """The query in a region frame turned by a quarter: what was along x lies along y."""
    maps = {
        name: each.replace(height=np.ascontiguousarray(np.rot90(each.height)))
        for name, each in (("heights", query.heights), ("ceilings", query.ceilings))
    }
    return query.replace(**maps)


def test_features_and_pictures_do_not_change_when_all_is_turned():
    query = made_up_query()
    poses = pose_at([-0.05, 0.02, 0.05, 0.3], [0.1, 0.01, 0.05, 1.0], [0.04, 0.03, 0.16, 2.0])
    # A quarter of a turn takes x, y to -y, x.
    after = np.column_stack([-poses[:, 1], poses[:, 0], poses[:, 2], poses[:, 3] + np.pi / 2])
    shape = own_shape(query)
    other = turned(query)
    features = np.array(features_of(query, poses))
    # The distances to the region's sides along x and y change places.
    features[:, [7, 8]] = features[:, [8, 7]]
    # Columns at the border of two cells may fall to either side, and crowding looks around by 8 x 8 cells.
    found = np.asarray(features_of(other, after.astype(np.float32)))
    np.testing.assert_allclose(found, features, atol=0.1)
    assert (np.abs(found - features) < 1e-3).mean() > 0.85
    pictures = [
        crops_of(q.heights, q.ceilings, shape, p) for q, p in ((query, poses), (other, after))
    ]
    # A point at the border of two cells may fall to either side.
    assert np.mean(np.abs(np.subtract(*pictures)) > 1e-3) < 0.01


def test_a_mirrored_scene_is_a_mirrored_picture():
    query = made_up_query(standing=(0.05, 0.03), half=(0.03, 0.03, 0.04))
    mirrored = query.replace(
        heights=query.heights.replace(height=query.heights.height[:, ::-1].copy()),
        ceilings=query.ceilings.replace(height=query.ceilings.height[:, ::-1].copy()),
    )
    shape = own_shape(query)
    pose = pose_at([0.02, 0.013, 0.05, 0.0])
    other = pose * np.array([1, -1, 1, -1], np.float32)
    picture = crops_of(query.heights, query.ceilings, shape, pose)
    np.testing.assert_allclose(
        crops_of(mirrored.heights, mirrored.ceilings, shape, other), picture[:, :, ::-1], atol=1e-5
    )
    assert MIRRORED == (26, 27)
    query = query.replace(center_of_mass=np.array([0.01, 0.02, 0.0], np.float32))
    np.testing.assert_allclose(features_of(query, pose)[0, 26:28], [0.2, 0.4], rtol=1e-5)


# Learning


@pytest.mark.parametrize("name", HEADS)
@pytest.mark.slow
def test_placers_propose_under_jit_and_vmap(name, examples):
    head = HEADS[name]
    found = proposed(head.placer(jax.jit(head.init)(jax.random.key(1)), 1.5), examples)
    assert found.pose.shape == (3, NUM_PROPOSALS, 4)
    assert np.isfinite(found.pose).all()
    assert np.abs(found.pose[..., :2]).max() <= HALF
    apart = np.linalg.norm(found.pose[:, :, None, :2] - found.pose[:, None, :, :2], axis=-1)
    assert apart[:, ~np.eye(NUM_PROPOSALS, dtype=bool)].min() >= APART
    scores = np.asarray(found.score)
    assert ((scores > 0) & (scores < 1)).all()
    assert (np.diff(scores, axis=1) <= 0).all()


@pytest.mark.parametrize("true", [0.5, 1.0, 3.0])
def test_the_temperature_that_spread_the_logits_is_found(true):
    rng = np.random.default_rng(0)
    logits = rng.normal(scale=2.0, size=40_000)
    stood = rng.uniform(size=len(logits)) < 1 / (1 + np.exp(-logits))
    assert best_temperature(true * logits, stood) == pytest.approx(true, rel=0.06)


# Runs


class Taught:
    """A source of a few examples."""

    @property
    def record(self):
        return {"made": "up"}

    def load(self, split):
        return made_up_examples(4) if split == "val" else made_up_examples(8)


CONFIG = FitConfig(num_epochs=4, batch_size=4, learning_rate=1e-2)


def run(folder, head="scored", config=CONFIG):
    return PlacerTraining(HEADS[head], config, Taught(), folder, lambda line: None)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Of a head's name its placer of a short run, made when it is first asked for."""
    return functools.cache(lambda name: run(tmp_path_factory.mktemp(name), name).run())


def test_a_run_leaves_a_placer_that_tells_chances(runs):
    record = json.loads((runs("scored") / "record.json").read_text())
    assert record["validation"]["calibration"]["number"] == 4 * 6
    assert (runs("scored") / "calibration.png").stat().st_size > 1000
    # A run's folder will do as well as that of its placer.
    placer = load_placer(placer_folder(runs("scored").parent))
    assert placer.config == HEADS["scored"].config
    assert float(placer.temperature) == pytest.approx(record["temperature"])


def test_a_run_that_ends_while_its_picture_is_drawn_draws_it_when_it_goes_on(tmp_path, monkeypatch):
    config = dataclasses.replace(CONFIG, num_epochs=1)

    def killed(*args):
        raise SystemExit

    with monkeypatch.context() as patch:
        patch.setattr(training, "draw_calibration", killed)
        with pytest.raises(SystemExit):
            run(tmp_path / "run", "scored", config).run()
    placer = run(tmp_path / "run", "scored", config).run()
    assert {each.name for each in placer.iterdir()} == {
        "calibration.png",
        "record.json",
        "weights.npz",
    }


@pytest.mark.slow
def test_a_run_that_was_stopped_ends_as_one_that_was_not(runs, tmp_path, monkeypatch):
    whole = runs("scored")
    stopped = run(tmp_path / "stopped")
    batch = fitting.batch_of

    def stop(number, *sizes):
        if number == 3:
            import signal

            signal.raise_signal(signal.SIGINT)
        return batch(number, *sizes)

    with monkeypatch.context() as patch:
        patch.setattr(fitting, "batch_of", stop)
        with pytest.raises(KeyboardInterrupt):
            stopped.run()
    assert not (tmp_path / "stopped" / "placer").exists()
    again = run(tmp_path / "stopped").run()
    files = [
        {path.name: path.read_bytes() for path in folder.iterdir()} for folder in (whole, again)
    ]
    assert set(files[0]) == {"calibration.png", "record.json", "weights.npz"}
    weights = [np.load(folder / "weights.npz") for folder in (whole, again)]
    for name in weights[0].files:
        np.testing.assert_array_equal(weights[0][name], weights[1][name])
    rows = [(folder.parent / "metrics.csv").read_text().splitlines() for folder in (whole, again)]
    assert len(rows[0]) == len(rows[1]) == 5
    with pytest.raises(ConfigError, match="another fit"):
        run(tmp_path / "stopped", config=dataclasses.replace(CONFIG, num_epochs=5))


@pytest.mark.parametrize("name", HEADS)
def test_a_stored_placer_proposes_what_it_did(name, tmp_path, examples):
    head = HEADS[name]
    # What half precision can hold, so that what is stored is what was there.
    drawn = jax.jit(head.init)(jax.random.key(2))
    params = jax.tree.map(lambda leaf: np.asarray(leaf, np.float16).astype(np.float32), drawn)
    record = {
        "kind": "placer",
        "head": name,
        "network": dataclasses.asdict(head.config),
        "temperature": 1.5,
    }
    save_policy(tmp_path, params, record)
    there, back = (
        proposed(each, examples) for each in (head.placer(params, 1.5), load_placer(tmp_path))
    )
    np.testing.assert_array_equal(there.pose, back.pose)
    np.testing.assert_array_equal(there.score, back.score)


def test_a_head_that_is_not_there_is_named(tmp_path):
    save_policy(tmp_path, {}, {"kind": "placer", "head": "regression"})
    with pytest.raises(PoolError, match=r"'regression'.*scored"):
        load_placer(tmp_path)
    with pytest.raises(ConfigError, match=r"'regression'.*scored"):
        cg.placer_train(tmp_path, head="regression")
