"""A robot in a bank of scenes as a LeRobot EnvHub environment, the one of `cluttergen_jax.robot.make_env`.

    from lerobot.envs.factory import make_env
    envs = make_env("OWNER/NAME", n_envs=4, trust_remote_code=True)["cluttergen"][0]

This file and all that lies beside it are the repository; it needs mujoco, pyarrow, gymnasium and
Python 3.11. Without LeRobot: `import env; env.single("grasp")`, or `gymnasium.make("cluttergen/Grasp-v1")`
once it is imported, which takes these ids from cluttergen_jax.
"""

import os
import sys
from functools import partial
from pathlib import Path

import gymnasium

os.environ.setdefault("MUJOCO_GL", "egl")
_FOLDER = Path(__file__).absolute().parent
CAMERAS = ("front", "hand")


def _complete():
    """The folder of the whole repository: a hub may have fetched this file alone."""
    if (_FOLDER / "bank").is_dir():
        return _FOLDER
    from huggingface_hub import snapshot_download

    kind, owner, name = _FOLDER.parents[1].name.split("--", 2)
    return Path(
        snapshot_download(f"{owner}/{name}", revision=_FOLDER.name, repo_type=kind.rstrip("s"))
    )


FOLDER = _complete()
if str(FOLDER) not in sys.path:
    # Where worker processes find it, too.
    sys.path.insert(0, str(FOLDER))

from cluttergen_env.exported import make_env as _make, register_ids  # noqa: E402, I001

register_ids(FOLDER)


def single(task="place", **settings):
    """One environment.

    Settings: `bank` (another one of the same objects), `action` ("joint", "joint_delta"), `cameras`,
    `image_size`, `control_hz`, `max_seconds`, `reward`, `render_mode`.
    """
    return _make(FOLDER, task, **settings)


def make_env(n_envs=1, use_async_envs=False, cfg=None, task="place"):
    """What LeRobot calls: vectors of environments by name and number of a task."""
    kind = gymnasium.vector.AsyncVectorEnv if use_async_envs else gymnasium.vector.SyncVectorEnv
    # Where LeRobot looks for success there is something only with this mode.
    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    one = partial(_make, str(FOLDER), task, cameras=CAMERAS)
    return {"cluttergen": {0: kind([one] * n_envs, autoreset_mode=mode)}}
