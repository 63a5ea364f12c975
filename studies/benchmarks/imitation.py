"""A policy of flow matching that imitates episodes: what it sees, its examples, and how it is fitted.

It predicts the next pose at which the tool of a demonstration came to rest, and what the gripper does there,
as policies of key poses do (James and Davison, "Q-attention", RA-L 2022; Shridhar et al., "Perceiver-Actor",
CoRL 2022). Of several ways to grasp the same object one is drawn, where a regression would give their mean
(Lipman et al., "Flow Matching for Generative Modeling", ICLR 2023). What it sees is in the tool's frame, so
that the tool can be shifted in an example: where it shall go stays where it is, and it learns to come back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from jax.scipy.spatial.transform import Rotation

from cluttergen_jax.downstream.fitting import take
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.progress import Progress
from cluttergen_jax.types import Array

_METRES = 0.1
"""Of distances in the input: the unit."""
_FINE = (0.01, 0.03, 0.1)
"""Metres over which the network sees small distances."""
# Metres and radians, deviations by which the tool is shifted in half of the examples.
_SHIFT = 0.005
_SHIFT_TURN = 0.03

# Metres that a tool at rest moves in a step at most; metres and radians between key poses that are one.
_STILL = 0.0015
_SAME = 0.012
_SAME_TURN = 0.1

# Metres, radians and share of the gripper from which on a key pose is reached.
_THERE = 0.006
_THERE_TURN = 0.05
_SAME_GRIP = 0.2

_ABOUT = 1
"""Steps about a key pose that are learnt from as often as all others: a policy is asked there."""
_SMALL = 0.02
"""Metres beyond which distances in the output are compressed, so that near ones are precise."""
_FLOW_STEPS = 10
_PER_OBJECT = 128
_NUM_BLOCKS = 4
_BATCH = 512
_RATE = 1e-3
_AVERAGE = 0.999


def frames_of(poses: np.ndarray) -> dict[str, np.ndarray]:
    """`place` f32[..., 3] and `turn` f32[..., 3, 3] of poses f[..., 7], wxyz."""
    flat = poses.reshape(-1, 7).astype(np.float64)
    turns = np.array([rotation_matrix(each) for each in flat[:, 3:]]).reshape(
        *poses.shape[:-1], 3, 3
    )
    return {"place": poses[..., :3].astype(np.float32), "turn": turns.astype(np.float32)}


def state_of(
    agent_pos: np.ndarray, objects: np.ndarray, goal: np.ndarray, grip: np.ndarray
) -> dict[str, Any]:
    """What is known in T steps.

    Args:
      agent_pos: f[T, 2 n + 8]; objects: f[T, N, 11]; goal: f[T, 7]; see `RobotEnv`.
      grip: f[T], what the gripper was told last.
    """
    rows = objects.copy()
    rows[rows[..., 10] == 0, 3] = 1.0
    return {
        "tool": frames_of(agent_pos[:, -7:]),
        "opening": agent_pos[:, -8].astype(np.float32),
        "objects": frames_of(rows[..., :7]),
        "half": rows[..., 7:10].astype(np.float32),
        "is_there": rows[..., 10].astype(np.float32),
        "goal": frames_of(goal),
        "grip": grip.astype(np.float32),
    }


def examples_of(episode: Mapping[str, np.ndarray], tools: np.ndarray) -> dict[str, Any]:
    """The steps of an episode.

    Args:
      episode: `agent_pos`, `objects`, `action` and `goal` of T steps.
      tools: f64[T, 4, 4], T_world_tool of the set-points before each step.
    """
    number = len(tools)
    grip = np.concatenate([[1.0], episode["action"][:-1, -1]])
    goal = np.tile(episode["goal"], (number, 1))
    keys = key_steps(tools, grip)
    which = next_keys(tools, grip, keys)
    wanted = {
        "place": tools[which, :3, 3].astype(np.float32),
        "turn": tools[which, :3, :3].astype(np.float32),
        "grip": grip[which].astype(np.float32),
    }
    away = np.abs(np.arange(number)[:, None] - np.array([0, *keys])).min(1)
    state = state_of(episode["agent_pos"], episode["objects"], goal, grip)
    return {**state, "wanted": wanted, "is_key": away <= _ABOUT}


def key_steps(tools: np.ndarray, grip: np.ndarray) -> list[int]:
    """The steps at which a tool f64[T, 4, 4] came to rest or changed its grip f[T], and the last one."""
    moved = np.linalg.norm(np.diff(tools[:, :3, 3], axis=0), axis=1)
    is_still = np.append(moved < _STILL, True)
    begins = np.flatnonzero(is_still & ~np.append(True, is_still[:-1]))
    ends = np.flatnonzero(is_still & ~np.append(is_still[1:], False))
    found: list[int] = []
    for step in sorted({*begins.tolist(), *ends.tolist(), len(tools) - 1}):
        while found and _is_same(tools, grip, found[-1], step, _SAME, _SAME_TURN):
            found.pop()
        found.append(step)
    return found


def _is_same(
    tools: np.ndarray, grip: np.ndarray, first: int, second: int, metres: float, radians: float
) -> bool:
    a = tools[first]
    b = tools[second]
    angle = np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))
    is_near = np.linalg.norm(a[:3, 3] - b[:3, 3]) < metres and angle < radians
    return bool(is_near and abs(grip[first] - grip[second]) < _SAME_GRIP)


def next_keys(tools: np.ndarray, grip: np.ndarray, keys: Sequence[int]) -> np.ndarray:
    """i[T]: the step of the next key pose that is not reached; of the last one at the end."""
    found = np.zeros(len(tools), int)
    for step in range(len(tools)):
        ahead = [key for key in keys if key >= max(step, found[step - 1])]
        if len(ahead) > 1 and _is_same(tools, grip, step, ahead[0], _THERE, _THERE_TURN):
            ahead.pop(0)
        found[step] = ahead[0]
    return found


def _lengths(metres: Array) -> Array:
    """f[..., 4 K] of f[..., K]: coarse for what is far, and fine for what is near."""
    fine = [jnp.tanh(metres / scale) for scale in _FINE]
    return jnp.concatenate([metres / _METRES, *fine], axis=-1)


def _about(tool: Mapping[str, Array], other: Mapping[str, Array]) -> Array:
    """f[..., 18]: another frame in the tool's."""
    away = jnp.einsum("...ji,...j->...i", tool["turn"], other["place"] - tool["place"])
    turn = jnp.einsum("...ji,...jk->...ik", tool["turn"], other["turn"])[..., :2]
    return jnp.concatenate([_lengths(away), turn.reshape(*turn.shape[:-2], 6)], axis=-1)


def _read(state: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """One step as the network sees it: f[K] of the arm, the target and its goal; f[M, L] of others; f[M]."""
    tool = state["tool"]
    half = state["half"] / _METRES
    target = jax.tree.map(lambda leaf: leaf[0], state["objects"])
    others = jax.tree.map(lambda leaf: leaf[1:], state["objects"])
    goal = state["goal"]
    own = [
        _lengths(state["opening"][None]),
        state["grip"][None],
        tool["place"] / _METRES,
        tool["turn"][:, :2].ravel(),
        _about(tool, target),
        half[0],
        target["place"] / _METRES,
        _lengths(goal["place"] - target["place"]),
        _about(tool, goal),
        _about(target, goal)[-6:],
    ]
    around = jax.vmap(lambda each: _about(tool, each))(others)
    to_goal = (others["place"] - goal["place"]) / _METRES
    upright = others["turn"][:, 2]
    rows = jnp.concatenate([around, to_goal, upright, half[1:]], axis=-1)
    return jnp.concatenate(own), rows, state["is_there"][1:]


def _references(state: Mapping[str, Any]) -> dict[str, Array]:
    """`place` f[3, 3] and `turn` f[3, 3, 3] of frames that key poses are expressed in.

    The tool's, the target's, and the tool's as if the target, held as it is now, was at its goal.
    """
    tool = state["tool"]
    goal = state["goal"]
    target = jax.tree.map(lambda leaf: leaf[0], state["objects"])
    turn = goal["turn"] @ target["turn"].T
    placed = {
        "place": goal["place"] + turn @ (tool["place"] - target["place"]),
        "turn": turn @ tool["turn"],
    }
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), tool, target, placed)


def encode_key(state: Mapping[str, Any], wanted: Mapping[str, Array]) -> Array:
    """f[28]: a key pose in each of the references, and the gripper."""
    frames = _references(state)
    away = jnp.einsum("rji,rj->ri", frames["turn"], wanted["place"] - frames["place"])
    turn = jnp.einsum("rji,jk->rik", frames["turn"], wanted["turn"])[..., :2].reshape(3, 6)
    rows = jnp.concatenate([jnp.arcsinh(away / _SMALL), turn], axis=-1)
    return jnp.append(rows.ravel(), wanted["grip"])


def decode_key(state: Mapping[str, Any], code: Array) -> tuple[Array, Array]:
    """f[4, 4], T_world_tool, and f, the gripper: the inverse of `encode_key`, in the nearest reference."""
    frames = _references(state)
    rows = code[:-1].reshape(3, 9)
    away = jnp.sinh(rows[:, :3]) * _SMALL
    nearest = jnp.argmin((away**2).sum(-1))
    first, second = jnp.moveaxis(rows[nearest, 3:].reshape(3, 2), -1, 0)
    x = first / jnp.linalg.norm(first)
    y = second - x * (x @ second)
    y /= jnp.linalg.norm(y)
    turn = frames["turn"][nearest] @ jnp.stack([x, y, jnp.cross(x, y)], axis=-1)
    place = frames["place"][nearest] + frames["turn"][nearest] @ away[nearest]
    return jnp.eye(4).at[:3, :3].set(turn).at[:3, 3].set(place), code[-1]


def shift_tool(state: dict[str, Any], key: Array) -> dict[str, Any]:
    """The same step with the tool, and with what it holds, a little elsewhere."""
    keys = jax.random.split(key, 3)
    share = jax.random.bernoulli(keys[0]).astype(jnp.float32)
    turn = Rotation.from_rotvec(share * _SHIFT_TURN * jax.random.normal(keys[1], (3,))).as_matrix()
    shift = share * _SHIFT * jax.random.normal(keys[2], (3,))
    tool = state["tool"]
    moved = {"place": tool["place"] + shift, "turn": turn @ tool["turn"]}
    places = state["objects"]["place"]
    turns = state["objects"]["turn"]
    held = {
        "place": places.at[0].set(moved["place"] + turn @ (places[0] - tool["place"])),
        "turn": turns.at[0].set(turn @ turns[0]),
    }
    objects = jax.tree.map(lambda a, b: jnp.where(state["grip"] < 0, a, b), held, state["objects"])
    return {**state, "tool": moved, "objects": objects}


class FlowNetwork(nn.Module):
    """The flow's velocity at f[28] and a time from 0 to 1, in a step."""

    width: int

    @nn.compact
    def __call__(
        self, own: Array, others: Array, is_there: Array, code: Array, time: Array
    ) -> Array:
        """See class."""
        after = nn.Dense(_PER_OBJECT)
        before = nn.Dense(_PER_OBJECT)
        rows = jnp.concatenate([others, jnp.broadcast_to(own, (len(others), len(own)))], axis=-1)
        rows = nn.gelu(after(nn.gelu(before(rows))))
        seen = jnp.max(jnp.where(is_there[:, None] > 0, rows, 0.0), axis=0)
        waves = time * 2.0 ** jnp.arange(6) * jnp.pi / 2
        x = jnp.concatenate([own, seen, code, jnp.sin(waves), jnp.cos(waves)])
        x = nn.Dense(self.width)(x)
        for _ in range(_NUM_BLOCKS):
            x += nn.Dense(self.width)(nn.gelu(nn.Dense(self.width)(nn.LayerNorm()(x))))
        return nn.Dense(len(code))(nn.LayerNorm()(x))


class Policy(struct.PyTreeNode):
    """What was learnt.

    Attributes:
      params: of the network.
      scales: mean and deviation of its inputs about itself and about others, and of its output.
      width: of the network.
    """

    params: Any
    scales: Any
    width: int = struct.field(pytree_node=False)

    def velocity(self, params: Any, state: Mapping[str, Any], code: Array, time: Array) -> Array:
        """f[28]: of the flow at f[28] and a time, in a step."""
        own, others, is_there = _read(state)
        (m, s), (n, t), _ = self.scales
        seen = ((own - m) / s, (others - n) / t, is_there)
        found: Array = FlowNetwork(self.width).apply(params, *seen, code, time)
        return found

    def loss(self, params: Any, example: dict[str, Any], key: Array) -> Array:
        """f: of the velocity on the straight way from noise to what an example wants."""
        keys = jax.random.split(key, 3)
        moved = shift_tool(example, keys[0])
        mean, spread = self.scales[2]
        code = (encode_key(moved, moved["wanted"]) - mean) / spread
        noise = jax.random.normal(keys[1], code.shape)
        time = jax.random.uniform(keys[2])
        made = self.velocity(params, moved, time * code + (1 - time) * noise, time)
        return ((made - (code - noise)) ** 2).mean()

    @jax.jit
    def next_key(self, state: Mapping[str, Any], key: Array) -> tuple[Array, Array]:
        """f[4, 4], T_world_tool where the tool shall come to rest, and f, the gripper there.

        Args:
          state: of `state_of`, one step.
        """
        now = jax.tree.map(lambda leaf: leaf[0], state)
        mean, spread = self.scales[2]
        code = jax.random.normal(key, mean.shape)
        for step in range(_FLOW_STEPS):
            time = jnp.float32(step / _FLOW_STEPS)
            code += self.velocity(self.params, now, code, time) / _FLOW_STEPS
        return decode_key(now, code * spread + mean)


def fit(episodes: Sequence[dict[str, Any]], num_updates: int, width: int) -> Policy:
    """The policy that imitates examples of episodes."""
    data = jax.tree.map(lambda *leaves: np.concatenate(leaves), *episodes)
    number = len(data["opening"])
    rng = np.random.default_rng(0)
    policy = _blank_policy(take(data, rng.choice(number, min(number, 8192), replace=False)), width)
    schedule = optax.warmup_cosine_decay_schedule(
        0.0, _RATE, max(num_updates // 20, 1), num_updates
    )
    optimizer = optax.chain(
        optax.clip_by_global_norm(1.0), optax.adamw(schedule, weight_decay=1e-4)
    )

    @jax.jit
    def update(params: Any, mean: Any, state: Any, batch: Any, key: Array) -> Any:
        def loss(params: Any) -> Array:
            keys = jax.random.split(key, _BATCH)
            return jax.vmap(policy.loss, (None, 0, 0))(params, batch, keys).mean()

        value, slope = jax.value_and_grad(loss)(params)
        change, state = optimizer.update(slope, state, params)
        params = optax.apply_updates(params, change)
        mean = jax.tree.map(lambda a, b: _AVERAGE * a + (1 - _AVERAGE) * b, mean, params)
        return params, mean, state, value

    is_key = data.pop("is_key")
    chance = np.where(is_key, 0.5 / is_key.sum(), 0.5 / max((~is_key).sum(), 1))
    ends = np.cumsum(chance) / chance.sum()
    params = mean = policy.params
    state = optimizer.init(params)
    with Progress("training", num_updates, "update") as progress:
        for step in range(num_updates):
            batch = take(data, np.searchsorted(ends, rng.random(_BATCH)))
            params, mean, state, value = update(params, mean, state, batch, jax.random.key(step))
            progress.update(1, f"loss {float(value):.3f}" if step % 100 == 0 else "")
    return policy.replace(params=mean)


def _blank_policy(some: dict[str, Any], width: int) -> Policy:
    """With fresh weights, and the scales of some examples."""
    own, others, is_there = jax.jit(jax.vmap(_read))(some)
    code = jax.jit(jax.vmap(encode_key))(some, some["wanted"])
    scales = [(each.mean(0), each.std(0) + 1e-2) for each in (own, others[is_there > 0], code)]
    time = jnp.zeros(())
    params = FlowNetwork(width).init(
        jax.random.key(0), own[0], others[0], is_there[0], code[0], time
    )
    return Policy(params, scales, width)
