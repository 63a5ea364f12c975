"""Encoders of point clouds: sampling and searching against NumPy, masks, moves, orders, frozen weights."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from cluttergen_jax.assets.cloud import farthest_first
from cluttergen_jax.learning.agents import Agent
from cluttergen_jax.learning.networks import cloud_encoder
from cluttergen_jax.learning.networks.actor_critic import NetworkConfig
from cluttergen_jax.learning.networks.cloud_encoder import (
    CloudEncoder,
    CloudNet,
    ball_query,
    encode_scenes,
    init_encoder,
)
from cluttergen_jax.learning.ppo.ppo import PPO, PPOConfig
from cluttergen_jax.placement.env import PlacementEnv
from tests.helpers.problems import made_up_rules

KINDS = ("pointnet", "pointnet2")
SMALL = NetworkConfig(
    scene_encoder="pointnet2",
    object_points=16,
    object_features=8,
    scene_points=96,
    scene_features=8,
    num_centroids=24,
    group_size=4,
    history_width=8,
    num_layers=1,
    width=8,
)
NUM_OBJECTS = 4


def points(number, seed=0, scale=0.5):
    return np.random.default_rng(seed).normal(size=(number, 3)).astype(np.float32) * scale


def world(seed=0):
    """Clouds f32[K, 32, 3] in farthest-point order and half extents f32[K, 3], metres."""
    clouds = np.stack([points(32, seed + k, 0.03) for k in range(NUM_OBJECTS)])
    clouds = np.stack([cloud[farthest_first(cloud)] for cloud in clouds])
    return jnp.asarray(clouds), jnp.asarray(np.abs(clouds).max(1))


def scenes(batch, seed=0):
    """Observations as far as encoders read them."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-0.2, 0.2, (batch, NUM_OBJECTS, 3))
    turn = rng.normal(size=(batch, NUM_OBJECTS, 4))
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    is_placed = rng.uniform(size=(batch, NUM_OBJECTS)) < 0.6
    poses = np.concatenate([place, turn], -1) * is_placed[..., None]
    return {
        "T_region_object": jnp.asarray(poses, jnp.float32),
        "is_placed": jnp.asarray(is_placed),
        "region": jnp.tile(jnp.array([0.3, 0.35, 0.2]), (batch, 1)),
    }


@pytest.fixture(scope="module", params=KINDS)
def encoder(request):
    config = dataclasses.replace(SMALL, scene_encoder=request.param)
    module = CloudEncoder(config, NUM_OBJECTS)
    return module, init_encoder(module, jax.random.key(0), *world())


@pytest.fixture(scope="module", params=KINDS)
def net(request):
    """A compiled network on clouds of 40 points with 12 centroids, given as their indices."""
    module = CloudNet(request.param, 8, 4)
    cloud = jnp.asarray(points(40))
    mask = jnp.ones(40, bool)
    weights = jax.jit(module.init)(jax.random.key(1), cloud, mask, jnp.arange(12))
    return jax.jit(lambda cloud, mask, index: module.apply(weights, cloud, mask, index))


@pytest.mark.parametrize("at_once", [1 << 20, 150])
def test_ball_query_finds_what_a_tree_finds(monkeypatch, at_once):
    monkeypatch.setattr(cloud_encoder, "_SEARCHED_AT_ONCE", at_once)
    cloud = points(50)
    centres = points(9, 3)
    radius = 0.4
    number = 5
    mask = np.random.default_rng(2).uniform(size=50) < 0.7
    index, is_found = jax.jit(ball_query, static_argnums=(3, 4))(
        centres, cloud, mask, radius, number
    )
    among = np.flatnonzero(mask)
    distance, nearest = cKDTree(cloud[among]).query(centres, number, distance_upper_bound=radius)
    np.testing.assert_array_equal(is_found, np.isfinite(distance))
    assert 0 < np.isfinite(distance).mean() < 1
    for row, theirs, found in zip(np.asarray(index), nearest, np.asarray(is_found), strict=True):
        np.testing.assert_array_equal(row[found], among[theirs[found]])


def test_masked_points_do_not_matter_whatever_they_are(net):
    cloud = points(40)
    mask = np.random.default_rng(4).uniform(size=40) < 0.6
    mask[:3] = True
    expected = net(cloud, mask, jnp.arange(12))
    for wrong in (1e6, np.nan, 0.0):
        np.testing.assert_array_equal(
            net(np.where(mask[:, None], cloud, wrong), mask, jnp.arange(12)), expected
        )
    assert np.abs(net(cloud, ~mask, jnp.arange(12)) - expected).max() > 1e-2


def test_order_of_points_does_not_matter(net):
    cloud = points(40)
    mask = np.arange(40) < 30
    order = np.random.default_rng(5).permutation(40)
    moved = np.argsort(order)[:12]
    np.testing.assert_allclose(
        net(cloud[order], mask[order], moved), net(cloud, mask, jnp.arange(12)), atol=1e-5
    )


def test_scene_features_see_poses_of_placed_objects_only(encoder):
    module, weights = encoder
    clouds, _ = world()
    seen = scenes(3) | {"is_placed": jnp.array([[True, False, True, False]] * 2 + [[False] * 4])}
    encode = jax.jit(lambda seen: encode_scenes(module, weights, clouds, seen))
    features = encode(seen)
    assert np.isfinite(features).all()
    moved = seen["T_region_object"].at[:, 1, :3].add(0.1)
    np.testing.assert_array_equal(features, encode(seen | {"T_region_object": moved}))
    # Farther than anything else, where even a PointNet of few features notices it.
    change = np.abs(encode(seen | {"T_region_object": moved.at[:, 0, :3].add(1.0)}) - features).max(
        1
    )
    assert (change[:2] > 1e-3).all()
    assert change[2] == 0


@pytest.mark.slow
def test_chunks_change_neither_features_nor_gradient(monkeypatch):
    module = CloudEncoder(SMALL, NUM_OBJECTS)
    clouds, half = world()
    weights = init_encoder(module, jax.random.key(0), clouds, half)
    seen = scenes(5)
    results = []
    for size in (5, 2):
        monkeypatch.setattr(cloud_encoder, "CHUNK", size)

        def total(weights):
            features = encode_scenes(module, weights, clouds, seen)
            return jnp.sum(features * jnp.arange(8.0)), features

        slope, features = jax.jit(jax.grad(total, has_aux=True))(weights)
        results.append((features, slope["scene_net"]))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-4, rtol=1e-3), *results)


@pytest.mark.slow
def test_frozen_weights_keep_their_bits_through_an_update():
    config = dataclasses.replace(SMALL, scene_encoder="pointnet", encoder_frozen=True)
    rules = made_up_rules(history_stride=12, reward="compressed")
    geometry = rules.geometry.replace(cloud=jnp.tile(world()[0], (2, 1, 1))[:6])
    agent = Agent(config, geometry.cloud, geometry.half_extents, 4)
    numbers = PPOConfig(num_envs=4, num_steps=4, num_minibatches=2, num_epochs=2, num_attempts=64)
    ppo = PPO(PlacementEnv(rules), agent.apply, numbers, encode=agent.encode)
    observation = jax.eval_shape(ppo.env.reset, jax.random.key(0)).obs
    start = ppo.start(jax.random.key(0), agent.init(jax.random.key(1), observation))
    after, _ = jax.jit(ppo.update)(start)
    same = jax.tree.map(
        lambda a, b: bool((a == b).all()), start.params["params"], after.params["params"]
    )
    assert all(jax.tree.leaves(same.pop("encoder")))
    assert not any(jax.tree.leaves(same))


@pytest.mark.parametrize("kind", ["set", *KINDS])
def test_renumbering_the_objects_leaves_actions_unchanged(kind):
    config = dataclasses.replace(SMALL, scene_encoder=kind, history_width=0, token_width=8)
    clouds, half = world()
    agent = Agent(config, clouds, half, NUM_OBJECTS)
    seen = scenes(3) | {"focus": jnp.array([0, 2, 1])}
    params = agent.init(jax.random.key(0), jax.tree.map(lambda leaf: leaf[0], seen))
    order = jnp.array([3, 0, 1, 2])
    renumbered = seen | {
        "focus": jnp.argsort(order)[seen["focus"]],
        "is_placed": seen["is_placed"][:, order],
        "T_region_object": seen["T_region_object"][:, order],
    }

    @jax.jit
    def act(clouds, half, seen):
        dist, value = Agent(config, clouds, half, NUM_OBJECTS).apply(params, seen)
        return dist.mean(), value

    one = act(clouds, half, seen)
    two = act(clouds[order], half[order], renumbered)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), one, two)
    assert np.abs(one[1] - act(clouds, half, renumbered)[1]).max() > 1e-3
