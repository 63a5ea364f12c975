"""Runs a folder as LeRobot runs a repository of its EnvHub; needs lerobot, mujoco and pyarrow. Prints JSON.

python read_in_lerobot.py EXPORT OBJECT
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
from lerobot.envs import factory

folder = Path(sys.argv[1])
name = sys.argv[2]
# LeRobot fetches env.py alone into its cache, and env.py what else the repository has: both are stood for.
alone = Path(tempfile.mkdtemp()) / "models--owner--clutter" / "snapshots" / "abc"
alone.mkdir(parents=True)
shutil.copy(folder / "env.py", alone)
with (
    mock.patch("lerobot.envs.utils.hf_hub_download", return_value=str(alone / "env.py")),
    mock.patch("huggingface_hub.snapshot_download", return_value=str(folder)) as fetch,
):
    ((suite, tasks),) = factory.make_env("owner/clutter", n_envs=2, trust_remote_code=True).items()
fetch.assert_called_with("owner/clutter", revision="abc", repo_type="model")
envs = tasks[0]
observation, info = envs.reset(seed=[0, 1])
from lerobot.envs.utils import preprocess_observation  # noqa: E402

seen = preprocess_observation(observation)
report = {
    "suite": suite,
    "seen": {key: list(value.shape) for key, value in seen.items()},
    "tasks": list(envs.call("task_description")),
    "steps": list(envs.call("_max_episode_steps")),
}
# The object is lifted from above, by a script that knows where it is.
env = envs.envs[0].unwrapped
number = next(scene.index for scene in env.bank.successes() if name in scene.names)
env.reset(seed=0, options={"scene": number, "target": name})
place = env.data.body(name).xpos - env._origin
shift = 0.0


def go(height, is_open, num_steps):
    """Moves towards a height above the object's place, and says how the last step ended."""
    for _ in range(num_steps):
        speed = np.array([*place[:2], height, 0]) - env._aim[:4]
        result = env.step([*np.clip(speed * 10, -1, 1), 1 if is_open else -1])
    return result


go(0.4, True, 60)
shift = float(np.linalg.norm(env.data.body(name).xpos - env._origin - place))
go(place[2], True, 60)
go(place[2], False, 20)
_, reward, terminated, _, last = go(place[2] + 0.2, False, 60)
report |= {
    "shift": shift,
    "reward": reward,
    "terminated": terminated,
    "is_success": last["is_success"],
}
envs.close()
print(json.dumps(report))
