"""10 s of exported scenes beside a Panda in ManiSkill 3: python step_maniskill.py EXPORT SECONDS NUM_SCENES.

Prints JSON; see step_dm_control.py.
"""

import json
import sys
from pathlib import Path

# ruff: noqa: E402
folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, str(folder))

import cluttergen_maniskill
import gymnasium
import numpy as np

_HEADLESS = {"obs_mode": "none", "render_backend": "none", "sim_backend": "physx_cpu"}
_EVERY = 10

moves = []
is_finite = True
for path in sorted((folder / "scenes").glob("*.json"))[:num_scenes]:
    env = gymnasium.make(
        cluttergen_maniskill.ENV_ID, scene=int(path.stem), robot_uids="panda", **_HEADLESS
    )
    env.reset(seed=0)
    scene = env.unwrapped

    def positions(scene=scene):
        """f64[N, 3]."""
        return np.array([each.pose.p[0].tolist() for each in scene.objects.values()])

    start = positions()
    move = 0.0
    for step in range(round(seconds * scene.control_freq)):
        env.step(np.zeros(env.action_space.shape, np.float32))
        if step % _EVERY == _EVERY - 1:
            now = positions()
            is_finite &= bool(np.isfinite(now).all())
            move = max(move, float(np.linalg.norm(now - start, axis=1).max()))
    moves.append(move)
    env.close()
    print(f"{len(moves)} of {num_scenes}", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves, "is_finite": is_finite, "num_worlds": 1}))
