"""Runs a folder as LeRobot runs a repository of its EnvHub; needs lerobot, mujoco and pyarrow. Prints JSON.

python read_in_lerobot.py EXPORT ACTIONS

ACTIONS: an NPZ file: `tasks` and `seeds`, of episodes, and `actions`, f32[E, T, n + 1].
"""

import ast
import json
import shutil
import sys
import tempfile
from pathlib import Path
from unittest import mock

import gymnasium
import mujoco
import numpy as np
from lerobot.envs.utils import preprocess_observation

folder = Path(sys.argv[1])
# What users read is what is imported: `make_env`.
words = ast.get_docstring(ast.parse((folder / "env.py").read_text()))
(line,) = (each for each in words.splitlines() if each.startswith("    from lerobot"))
given_name = {}
exec(line.strip(), given_name)
# LeRobot fetches env.py alone into its cache, and env.py what else the repository has: both are stood for.
alone = Path(tempfile.mkdtemp()) / "models--owner--clutter" / "snapshots" / "abc"
alone.mkdir(parents=True)
shutil.copy(folder / "env.py", alone)
with (
    mock.patch("lerobot.envs.utils.hf_hub_download", return_value=str(alone / "env.py")),
    mock.patch("huggingface_hub.snapshot_download", return_value=str(folder)) as fetch,
):
    ((suite, tasks),) = given_name["make_env"](
        "owner/clutter", n_envs=2, trust_remote_code=True
    ).items()
fetch.assert_called_with("owner/clutter", revision="abc", repo_type="model")
envs = tasks[0]
report = {"suite": suite, "mujoco": mujoco.__version__}
try:
    observation, info = envs.reset(seed=[0, 1])
    seen = preprocess_observation(observation)
    report["seen"] = {key: list(value.shape) for key, value in seen.items()}
except RuntimeError as error:
    # Nothing here can draw.
    report["seen"] = str(error)
report["tasks"] = list(envs.call("task_description"))
report["steps"] = list(envs.call("_max_episode_steps"))
envs.close()
ends = []
given = np.load(sys.argv[2])
for task, seed, actions in zip(given["tasks"], given["seeds"], given["actions"], strict=True):
    env = gymnasium.make(f"cluttergen/{task.title()}-v1", action="joint_delta")
    _, info = env.reset(seed=int(seed))
    for action in actions:
        seen, reward, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    state = np.concatenate([seen["agent_pos"], seen["environment_state"]])
    ends.append({"scene": info["scene"], "target": info["target"], "state": state.tolist()})
report["ends"] = ends
report["jax"] = "jax" in sys.modules or "cluttergen_jax" in sys.modules
print(json.dumps(report))
