"""10 s of exported scenes in PyBullet: python step_pybullet.py EXPORT SECONDS NUM_SCENES.

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

import numpy as np
import pybullet
from load_pybullet import load_scene, object_pose

_LOOKS = 20

client = pybullet.connect(pybullet.DIRECT)
moves = []
is_finite = True
for path in sorted((folder / "scenes").glob("*.json"))[:num_scenes]:
    pybullet.resetSimulation(physicsClientId=client)
    bodies = load_scene(path, client)
    things = [body for name, body in bodies.items() if name != "support"]

    def positions(things=things):
        """f64[N, 3]."""
        return np.array([object_pose(body, client)[0] for body in things])

    timestep = pybullet.getPhysicsEngineParameters(physicsClientId=client)["fixedTimeStep"]
    start = positions()
    move = 0.0
    for _ in range(_LOOKS):
        for _ in range(round(seconds / timestep / _LOOKS)):
            pybullet.stepSimulation(physicsClientId=client)
        now = positions()
        is_finite &= bool(np.isfinite(now).all())
        move = max(move, float(np.linalg.norm(now - start, axis=1).max()))
    moves.append(move)
    print(f"{len(moves)} of {num_scenes}", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves, "is_finite": is_finite, "num_worlds": 1}))
