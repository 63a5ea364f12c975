"""A robot in a bank for LeRobot: push this file, with the bank in the folder `bank`, to a model repository.

The environment is that in which `cluttergen robot record bank` records; put a recording's `recording.json`
beside this file if it was made with other settings. What a policy learnt from it goes straight into `step`.

envs = lerobot.envs.make_env("OWNER/NAME", n_envs=4, trust_remote_code=True)["cluttergen"][0]
"""

from functools import partial
from pathlib import Path

import gymnasium

import cluttergen_jax as cg


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """What LeRobot calls: vectors of environments by name and number of a task."""
    kind = gymnasium.vector.AsyncVectorEnv if use_async_envs else gymnasium.vector.SyncVectorEnv
    folder = _folder()
    settings = {"cameras": ("front", "hand")}
    if (folder / "recording.json").is_file():
        settings = {"recording": folder}
    make = partial(cg.robot.make_env, bank=folder / "bank", **settings)
    # Where LeRobot looks for success there is something only with this mode.
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    return {"cluttergen": {0: kind([make] * n_envs, autoreset_mode=mode)}}


def _folder():
    """That of this file, which LeRobot fetched alone, with the bank beside it."""
    folder = Path(__file__).parent
    if not (folder / "bank").is_dir():
        from huggingface_hub import snapshot_download

        _, owner, name = folder.parents[1].name.split("--", 2)
        folder = Path(snapshot_download(f"{owner}/{name}", revision=folder.name))
    return folder
