"""PPO of Stable-Baselines3 learns to grasp in a bank, through `gymnasium.make`. Prints JSON.

python learn_with_sb3.py BANK STEPS

Extras `robot`, `gym` and `sb3`. What is printed: of each episode its return and how it ended.
"""

import json
import sys

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import cluttergen_jax  # noqa: F401  It makes the ids known.

bank = sys.argv[1]
num_steps = int(sys.argv[2])
torch.set_num_threads(1)


class Episodes(BaseCallback):
    """Keeps the return and the outcome of each episode."""

    def __init__(self):
        super().__init__()
        self.rows = []

    def _on_step(self):
        for info in self.locals["infos"]:
            if "episode" in info:
                self.rows.append((float(info["episode"]["r"]), info["outcome"]))
        return True

    def _on_rollout_end(self):
        last = [value for value, _ in self.rows[-20:]]
        mean = sum(last) / max(len(last), 1)
        print(f"{self.num_timesteps} steps, return {mean:.3f}", file=sys.stderr, flush=True)


def make():
    env = gymnasium.make(
        "cluttergen/Grasp-v1",
        bank=bank,
        reward="dense",
        physics="learning",
        action="tool",
        control_hz=10,
        max_seconds=6,
    )
    return Monitor(env, info_keywords=("outcome",))


episodes = Episodes()
model = PPO(
    "MultiInputPolicy",
    VecNormalize(DummyVecEnv([make]), gamma=0.97),
    n_steps=256,
    learning_rate=5e-4,
    gamma=0.97,
    seed=0,
    policy_kwargs={"log_std_init": -0.7, "net_arch": [64, 64]},
    device="cpu",
)
model.learn(num_steps, callback=episodes)
print(json.dumps(episodes.rows))
