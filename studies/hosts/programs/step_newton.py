"""10 s of exported scenes as worlds of Newton on a CPU: python step_newton.py EXPORT SECONDS NUM_SCENES.

Prints JSON; see step_dm_control.py.
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
sys.path.insert(0, folder)

import cluttergen_newton
import newton
import numpy as np
import warp

_STEP = 1 / 480
_LOOKS = 20

warp.set_device("cpu")
builder = newton.ModelBuilder()
worlds = cluttergen_newton.add_worlds(builder, cluttergen_newton.scene_numbers()[:num_scenes])
model = builder.finalize()
before = model.state()
after = model.state()
control = model.control()
newton.eval_fk(model, model.joint_q, model.joint_qd, before)
solver = cluttergen_newton.make_solver(model)
start = before.body_q.numpy()[:, :3].copy()
moves = np.zeros(len(start))
is_finite = True
for look in range(_LOOKS):
    for _ in range(round(seconds / _STEP / _LOOKS)):
        before.clear_forces()
        solver.step(before, after, control, None, _STEP)
        before, after = after, before
    now = before.body_q.numpy()
    is_finite &= bool(np.isfinite(now).all())
    moves = np.maximum(moves, np.linalg.norm(now[:, :3] - start, axis=1))
    print(f"{look + 1} of {_LOOKS} parts of {seconds:g} s", file=sys.stderr, flush=True)
largest = [float(moves[list(world.values())].max()) for world in worlds]
print(json.dumps({"moves": largest, "is_finite": is_finite, "num_worlds": len(worlds)}))
