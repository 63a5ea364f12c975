"""10 s of a bank in the environment that LeRobot makes: python step_lerobot.py EXPORT SECONDS NUM_SCENES.

Positions are those that the environment observes, in single precision. Prints JSON; see step_dm_control.py.
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, folder)

import env as exported
import lerobot.envs  # noqa: F401 - the environment works beside it
import numpy as np

_HZ = 20.0
_COLUMNS = 11
_EVERY = 10

env = exported.single("grasp", action="joint_delta", cameras=(), max_seconds=2 * seconds)


def positions(seen):
    """f32[N, 3] of the objects that are there."""
    rows = seen["environment_state"].reshape(-1, _COLUMNS)
    return rows[rows[:, -1] > 0, :3]


moves = []
is_finite = True
for number in env.unwrapped.scenes[:num_scenes]:
    seen, _ = env.reset(seed=0, options={"scene": number})
    start = positions(seen)
    move = 0.0
    for step in range(round(seconds * _HZ)):
        seen = env.step(np.zeros(env.action_space.shape, np.float32))[0]
        if step % _EVERY == _EVERY - 1:
            move = max(move, float(np.linalg.norm(positions(seen) - start, axis=1).max()))
            is_finite &= bool(np.isfinite(seen["environment_state"]).all())
    moves.append(move)
    print(f"{len(moves)} of {num_scenes}", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves, "is_finite": is_finite, "num_worlds": 1}))
