"""Behaviour cloning: key poses of an episode, their code, shifted tools, a small fit."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cluttergen_jax.downstream.transforms import matrix_of, pose_of
from studies.benchmarks.imitation import (
    Policy,
    decode_key,
    encode_key,
    examples_of,
    fit,
    key_steps,
    next_keys,
    shift_tool,
    state_of,
)

DOWN = np.diag([1.0, -1.0, -1.0])
GOAL = np.array([0.3, 0.2, 0.5, 1.0, 0, 0, 0])


def path(*stops, steps=10):
    """f64[T, 4, 4] and f64[T]: a tool that goes straight from stop to stop (x, y, z, grip) and rests."""
    rows = [np.tile(stops[0], (3, 1))]
    for first, second in pairwise(stops):
        share = np.concatenate([np.linspace(0, 1, steps), np.ones(3)])[:, None]
        rows.append((1 - share) * first + share * np.array(second))
    whole = np.concatenate(rows)
    tools = np.tile(np.eye(4), (len(whole), 1, 1))
    tools[:, :3, :3] = DOWN
    tools[:, :3, 3] = whole[:, :3]
    return tools, whole[:, 3]


STOPS = np.array(
    [[0, 0, 0.8, 1], [0.1, 0, 0.6, 1], [0.1, 0, 0.5, 1], [0.1, 0, 0.5, -1], [0.1, 0, 0.7, -1.0]]
)


def test_key_poses_are_where_the_tool_rests_and_where_the_grip_has_changed():
    tools, grip = path(*STOPS)
    keys = key_steps(tools, grip)
    found = np.column_stack([tools[keys, :3, 3], grip[keys]])
    np.testing.assert_allclose(found, STOPS, atol=1e-9)
    which = next_keys(tools, grip, keys)
    # At a key pose the next one is meant, and never one before it.
    assert (np.diff(which) >= 0).all()
    assert which[0] == keys[1]
    assert which[10] == keys[1]
    assert which[-1] == keys[-1]
    assert [which[key] for key in keys[:-1]] == keys[1:]


def episode():
    """A block at (0.1, 0, 0.5), another one, and the arm above."""
    tools, grip = path(*STOPS)
    objects = np.zeros((len(tools), 3, 11))
    objects[:, 0] = [0.1, 0, 0.5, 1, 0, 0, 0, 0.02, 0.03, 0.04, 1]
    objects[:, 1] = [0.4, 0.3, 0.5, 1, 0, 0, 0, 0.05, 0.05, 0.05, 1]
    held = grip < 0
    objects[held, 0, 2] = tools[held, 2, 3]
    poses = np.array([pose_of(each) for each in tools])
    agent_pos = np.concatenate(
        [np.zeros((len(tools), 14)), 0.02 + 0.02 * grip[:, None], poses], axis=1
    )
    action = np.zeros((len(tools), 8))
    action[:, -1] = np.append(grip[1:], grip[-1])
    return {"agent_pos": agent_pos, "objects": objects, "action": action, "goal": GOAL}, tools


def one(examples, step):
    """The example of one step."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[step]), examples)


def test_a_key_pose_is_decoded_as_it_was_encoded_in_each_reference():
    made, tools = episode()
    example = one(examples_of(made, tools), 5)
    turn = Rotation.from_euler("xyz", [3.0, 0.2, 0.7]).as_matrix()
    for place in ([0.1, 0.01, 0.51], [0.0, 0.02, 0.75], [0.3, 0.21, 0.6]):
        wanted = {
            "place": jnp.array(place),
            "turn": jnp.asarray(turn, jnp.float32),
            "grip": jnp.array(-0.5),
        }
        pose, grip = decode_key(example, encode_key(example, wanted))
        np.testing.assert_allclose(
            pose, np.block([[turn, np.array([place]).T], [np.eye(4)[3:]]]), atol=1e-5
        )
        assert grip == -0.5
    # Where the tool is when what it holds is at its goal, is 0 in the last reference.
    held = one(examples_of(made, tools), -1)
    T = matrix_of(GOAL) @ np.linalg.inv(matrix_of(made["objects"][-1, 0, :7])) @ tools[-1]
    at_goal = {
        "place": jnp.asarray(T[:3, 3]),
        "turn": jnp.asarray(T[:3, :3]),
        "grip": jnp.array(1.0),
    }
    np.testing.assert_allclose(encode_key(held, at_goal).reshape(-1)[18:21], 0, atol=1e-4)


def test_a_shifted_tool_takes_with_it_what_it_holds_and_nothing_else():
    made, tools = episode()
    examples = examples_of(made, tools)
    for step, is_held in ((5, False), (-1, True)):
        before = one(examples, step)
        moved = [shift_tool(before, jax.random.key(seed)) for seed in range(8)]
        shifts = [np.linalg.norm(each["tool"]["place"] - before["tool"]["place"]) for each in moved]
        assert min(shifts) == 0 < max(shifts) < 0.03
        for each in moved:
            np.testing.assert_array_equal(each["wanted"]["place"], before["wanted"]["place"])
            np.testing.assert_array_equal(
                each["objects"]["place"][1:], before["objects"]["place"][1:]
            )

            def seen(example):
                away = example["objects"]["place"][0] - example["tool"]["place"]
                return example["tool"]["turn"].T @ away

            stays = np.allclose(seen(each), seen(before), atol=1e-6)
            assert stays == (
                is_held or np.array_equal(each["tool"]["place"], before["tool"]["place"])
            )


@pytest.mark.slow
def test_a_policy_learns_the_key_poses_of_an_episode():
    made, tools = episode()
    policy = fit([examples_of(made, tools)], 1500, 64)
    assert isinstance(policy, Policy)
    keys = key_steps(tools, np.append(1.0, made["action"][:-1, -1]))
    for key, stop in zip(keys[:-1], STOPS[1:], strict=True):
        row = slice(key, key + 1)
        grip = np.append(1.0, made["action"][:-1, -1])[row]
        state = state_of(made["agent_pos"][row], made["objects"][row], GOAL[None], grip)
        pose, grip = policy.next_key(state, jax.random.key(0))
        # The farther it is, the less precise is its code: the stops are 10 and 20 cm apart.
        np.testing.assert_allclose(pose[:3, 3], stop[:3], atol=0.045)
        assert grip * stop[3] > 0.5
