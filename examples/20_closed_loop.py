# %% [markdown]
# # A closed loop in clutter
# Scenes are made, a planner's demonstrations are recorded in them, LeRobot's ACT learns from these and is run
# in the same environment, in other scenes. The state is observed, not pictures, so that a CPU does. Extras
# `robot` and `gym`, and `pip install lerobot==0.4.4`; without it this ends before the training.

# %%
import importlib.util
import subprocess
import sys

import matplotlib.pyplot as plt

import cluttergen_jax as cg

num_scenes = 160
num_tested = 48
num_steps = 6000
objects = ("cereal_box", "bowl", "mug", "soup_can", "pepper_mill")

# %% [markdown]
# Two banks of the same objects, of other seeds. `largest` places the pepper mill last: it is what the task
# `grasp` asks to be lifted, without pressing on anything else.

# %%
for name, number, seed in (("train", num_scenes, 0), ("test", num_tested, 1)):
    cg.generate(name, objects=objects, num_scenes=number, region="0.4x0.5", order="largest",
                seed=seed, render=False, max_files=0)  # fmt: skip

# %% [markdown]
# The recording is a LeRobot dataset; failures are kept, and only successes are learnt from.

# %%
recording = cg.robot.record("train", "demos", task="grasp", robot="panda_2f85", cameras=(),
                            num_episodes=num_scenes, physics="learning")  # fmt: skip
print(recording)

# %% [markdown]
# Its environment, in the scenes of the test: 48 episodes, by what is around the pepper mill. A planner that
# knows all and random actions are the bounds.

# %%
env = cg.robot.make_env(recording=recording, bank="test")
results = {name: cg.robot.evaluate_policy(env, name) for name in ("scripted", "random")}
for name, result in results.items():
    print(f"{name}\n{result}\n")

# %% [markdown]
# LeRobot's own trainer, `lerobot-train`, with a small network. Its defaults normalize no poses of objects.

# %%
options = {
    "dataset.repo_id": "me/demos",
    "dataset.root": "demos",
    "dataset.episodes": recording.successes,
    "policy.type": "act",
    "policy.device": "cpu",
    "policy.push_to_hub": "false",
    "policy.chunk_size": 32,
    "policy.n_action_steps": 16,
    "policy.dim_model": 128,
    "policy.dim_feedforward": 512,
    "policy.n_heads": 4,
    "policy.use_vae": "false",
    "policy.dropout": 0,
    "policy.optimizer_lr": 2e-4,
    "policy.normalization_mapping": '{"STATE": "MEAN_STD", "ENV": "MEAN_STD", "ACTION": "MEAN_STD"}',
    "batch_size": 32,
    "num_workers": 0,
    "steps": num_steps,
    "save_freq": num_steps // 6,
    "output_dir": "learnt",
}
if importlib.util.find_spec("lerobot") is None:
    print("LeRobot is not installed: pip install lerobot==0.4.4")
    raise SystemExit
command = [sys.executable, "-m", "lerobot.scripts.lerobot_train"]
subprocess.run([*command, *(f"--{name}={value}" for name, value in options.items())], check=True)

# %% [markdown]
# A policy is a function from what the environment observes to an action.

# %%
import torch  # noqa: E402
from lerobot.envs.utils import preprocess_observation  # noqa: E402
from lerobot.policies.act.modeling_act import ACTPolicy  # noqa: E402
from lerobot.policies.factory import make_pre_post_processors  # noqa: E402


class Learnt:
    """The policy of one checkpoint."""

    def __init__(self, folder: str):
        self.policy = ACTPolicy.from_pretrained(folder)
        self.before, self.after = make_pre_post_processors(self.policy.config, folder)
        self.reset = self.policy.reset

    @torch.inference_mode()
    def __call__(self, seen: dict):
        action = self.policy.select_action(self.before(preprocess_observation(seen)))
        return self.after(action)[0].numpy()


# %%
curve = {}
for step in range(num_steps // 6, num_steps + 1, num_steps // 6):
    policy = Learnt(f"learnt/checkpoints/{step:06d}/pretrained_model")
    result = cg.robot.evaluate_policy(env, policy)
    curve[step] = result.num_successes / len(result.episodes)
    print(f"after {step} steps\n{result}\n")

# %%
plt.figure(figsize=(6, 3.5), layout="constrained")
plt.plot(list(curve), list(curve.values()), marker="o", label="ACT")
for name, bound in results.items():
    plt.axhline(bound.num_successes / len(bound.episodes), ls="--", c="grey")
    plt.annotate(name, (0, bound.num_successes / len(bound.episodes)))
plt.xlabel("training steps")
plt.ylabel("lifted, of 48 unseen scenes")
plt.savefig("closed_loop.png", dpi=120)
