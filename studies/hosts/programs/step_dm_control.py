"""10 s of exported scenes in dm_control: python step_dm_control.py EXPORT SECONDS NUM_SCENES.

Prints JSON, as all programs of this folder, which import nothing of cluttergen_jax but what an export holds:
`moves`, metres that an object of each scene is away at most, at any time that is looked at; `is_finite`;
`num_worlds`, side by side in one model.
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, folder)

import numpy as np
from cluttergen_dm_control import ClutterArena, scene_numbers
from dm_control import mjcf

_LOOKS = 20

moves = []
is_finite = True
for number in scene_numbers()[:num_scenes]:
    arena = ClutterArena(scene=number)
    physics = mjcf.Physics.from_mjcf_model(arena.mjcf_model)
    things = [each for name, each in arena.objects.items() if name != "support"]

    def positions(things=things, physics=physics):
        """f64[N, 3]."""
        return np.array([each.get_pose(physics)[0] for each in things])

    start = positions()
    move = 0.0
    for _ in range(_LOOKS):
        physics.step(round(seconds / physics.timestep() / _LOOKS))
        move = max(move, float(np.linalg.norm(positions() - start, axis=1).max()))
        is_finite &= bool(np.isfinite(physics.data.qpos).all())
    moves.append(move)
    print(f"{len(moves)} of {num_scenes}", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves, "is_finite": is_finite, "num_worlds": 1}))
