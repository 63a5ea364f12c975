"""Reads a recording by robomimic's own code: its check of a dataset, its environment, each episode replayed.

python read_in_robomimic.py DEMO.hdf5

Needs robomimic, gym and cluttergen_jax with its extras robot, gym and record. Prints JSON.
"""

import json
import subprocess
import sys

import h5py
import numpy as np
from robomimic.utils import env_utils, file_utils, obs_utils

place = sys.argv[1]
check = [sys.executable, "-m", "robomimic.scripts.get_dataset_info", "--dataset", place]
subprocess.run(check, check=True, stdout=subprocess.DEVNULL)
obs_utils.initialize_obs_utils_with_obs_specs({"obs": {"low_dim": ["flat"], "rgb": []}})
env = env_utils.create_env_from_metadata(file_utils.get_env_metadata_from_dataset(place))
ends = []
diverged = 0
with h5py.File(place) as file:
    for number in range(len(file["data"])):
        demo = file[f"data/demo_{number}"]
        states = demo["states"][:]
        seen = env.reset_to({"states": states[0]})
        for step, action in enumerate(demo["actions"][:]):
            diverged += not np.array_equal(env.get_state()["states"], states[step])
            diverged += not np.array_equal(seen["flat"], demo["obs/flat"][step])
            seen, reward, is_over, info = env.step(action)
        ends.append(env.is_success()["task"])
size = env.reset()["flat"].shape
print(json.dumps({"success": ends, "diverged": diverged, "size": size}))
