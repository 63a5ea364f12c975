# %% [markdown]
# # A robot in a bank of scenes
# A bank and a Franka Panda in one MuJoCo model (extras `robot` and `gym`): resets of both, domain
# randomization, and a small training on one core: how high and how turned to grasp, found by trying.

# %%
import time

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

import cluttergen_jax as cg

num_scenes = 24
num_generations = 4
population = 12

# %%
cg.generate("grasp_bank", objects=("soup_can", "pepper_mill", "cereal_box"), num_scenes=num_scenes,
            region="0.5x0.6", order="random", render=False, max_files=0)  # fmt: skip
bank = cg.load_bank("grasp_bank")

# %% [markdown]
# `world.reset` is pure: with a key of JAX it may be compiled and mapped, for MJX with Warp on a GPU. With
# a whole number it gives arrays of NumPy, for MuJoCo itself, which is quicker on a CPU.

# %%
for physics in ("accurate", "learning"):
    world = cg.robot.with_robot(
        bank, physics=physics, randomization=cg.robot.RandomizationConfig(mass=(0.5, 2.0))
    )
    data = mujoco.MjData(world.model)
    state = world.reset(0)
    world.put(data, state)
    steps = round(0.05 / world.model.opt.timestep)
    begun = time.process_time()
    mujoco.mj_step(world.model, data, 20 * steps)
    cost = (time.process_time() - begun) / 20
    print(
        f"{physics}: scene {state.index}, {steps} steps in 50 ms take {1e3 * cost:.1f} ms; {world.limits}"
    )
    print(
        "  masses",
        dict(zip(world.names, world.model.body_mass[world.bodies].round(3), strict=True)),
    )


# %% [markdown]
# A policy of two numbers: how far above or below the object's middle, in its half heights, and how turned.
# It sees the state and moves the tool; the judge is that of `robot place --task lift`: nothing else may be
# moved or pressed on.


# %%
def act(seen: dict, step: int, policy: np.ndarray) -> np.ndarray:
    """Above it, down, close, up: 20 steps a second, f[7]."""
    tool = seen["agent_pos"][15:22]
    target = seen["environment_state"][:10]
    turn = Rotation.from_quat(target[3:7], scalar_first=True).as_euler("zyx")[0] + policy[1]
    if target[7] < target[8]:  # by its narrow side
        turn += np.pi / 2
    now = Rotation.from_quat(tool[3:], scalar_first=True).as_euler("ZYX")[0]
    error = (turn - now + np.pi / 2) % np.pi - np.pi / 2
    goal = target[:3].copy()
    goal[2] += policy[0] * target[9] + (0.25 if step < 40 else 0.0)
    shift = (goal - tool[:3]) / (0.5 * 0.05)  # shares of what a step can be
    if step >= 70:
        shift = np.array([0, 0, 0.4 * (step >= 85)])
        error = 0.0
    is_open = 1.0 if step < 70 else -1.0
    return np.clip([*0.3 * shift, 0, 0, 3 * error, is_open], -1, 1)


def episode(env, policy: np.ndarray, seed: int) -> tuple[float, dict]:
    """How well it went: 1 at success, else less the farther the hand came from lifting."""
    seen, info = env.reset(seed=seed)
    start = seen["environment_state"][2]
    gained = 0.0
    for step in range(env._max_episode_steps):
        seen, _, terminated, truncated, info = env.step(act(seen, step, policy))
        gained = max(gained, float(seen["environment_state"][2] - start))
        if terminated or truncated:
            break
    near = np.linalg.norm(seen["agent_pos"][15:18] - seen["environment_state"][:3])
    return float(info["is_success"]) + min(gained, 0.1) - 0.1 * float(near), info


# %%
env = cg.robot.make_env("grasp", bank, action="tool", physics="learning", max_seconds=6.0)
rng = np.random.default_rng(0)
mean = np.array([1.5, 0.8])
spread = np.array([1.0, 0.6])
begun = time.process_time()


def share(policy: np.ndarray) -> str:
    """How often it succeeds, in episodes that were not trained on, and all ends that there were."""
    ends = [episode(env, policy, 10_000 + k)[1]["outcome"] for k in range(2 * population)]
    return f"{ends.count('success')} of {len(ends)} lifted ({', '.join(sorted(set(ends)))})"


print("untrained:", share(mean))
for generation in range(num_generations):
    policies = mean + spread * rng.normal(size=(population, 2))
    seeds = 4 * generation + np.arange(4)
    found = [[episode(env, policy, int(seed)) for seed in seeds] for policy in policies]
    scores = np.array([[score for score, _ in row] for row in found])
    best = policies[np.argsort(-scores.mean(1))[: population // 4]]
    mean = best.mean(0)
    spread = best.std(0) + 0.05
    wins = sum(info["is_success"] for row in found for _, info in row)
    cost = time.process_time() - begun
    print(f"{cost:3.0f} CPU-s: {wins} of {scores.size} lifted; mean policy {mean.round(2)}")
print("trained:", share(mean))
