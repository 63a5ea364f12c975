"""10 s of exported scenes beside a Panda in robosuite: python step_robosuite.py EXPORT SECONDS NUM_SCENES.

Prints JSON; see step_dm_control.py.
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, folder)

import cluttergen_robosuite
import numpy as np
import robosuite

_HEADLESS = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
_EVERY = 10

moves = []
is_finite = True
for number in cluttergen_robosuite.scene_numbers()[:num_scenes]:
    env = robosuite.make(
        "ClutterGenScene", robots="Panda", scene=number, ignore_done=True, **_HEADLESS
    )
    env.reset()

    def positions(env=env):
        """f64[N, 3]."""
        names = [entry["name"] for entry in env.record["objects"]]
        return np.array([env.object_pose(name)[:3] for name in names])

    start = positions()
    move = 0.0
    for step in range(round(seconds * env.control_freq)):
        env.step(np.zeros(env.action_dim))
        if step % _EVERY == _EVERY - 1:
            move = max(move, float(np.linalg.norm(positions() - start, axis=1).max()))
            is_finite &= bool(np.isfinite(env.sim.data.qpos).all())
    moves.append(move)
    env.close()
    print(f"{len(moves)} of {num_scenes}", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves, "is_finite": is_finite, "num_worlds": 1}))
