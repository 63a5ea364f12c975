"""A robot in a bank for LeRobot: push this file, with the bank in the folder `bank`, to a model repository.

envs = lerobot.envs.make_env("OWNER/NAME", n_envs=4, trust_remote_code=True)["cluttergen"][0]
"""

from functools import partial
from pathlib import Path

import gymnasium

import cluttergen_jax as cg


def make_env(n_envs=1, use_async_envs=False, cfg=None):
    """What LeRobot calls: vectors of environments by name and number of a task."""
    kind = gymnasium.vector.AsyncVectorEnv if use_async_envs else gymnasium.vector.SyncVectorEnv
    make = partial(
        cg.robot.make_env, "place", _bank(), action="joint_delta", cameras=("front", "hand")
    )
    # Where LeRobot looks for success there is something only with this mode.
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    return {"cluttergen": {0: kind([make] * n_envs, autoreset_mode=mode)}}


def _bank():
    """The bank beside this file, which LeRobot fetched alone."""
    folder = Path(__file__).parent
    if not (folder / "bank").is_dir():
        from huggingface_hub import snapshot_download

        _, owner, name = folder.parents[1].name.split("--", 2)
        folder = Path(snapshot_download(f"{owner}/{name}", revision=folder.name))
    return folder / "bank"
