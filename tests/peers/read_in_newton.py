"""Steps exported scenes as worlds of Newton on a CPU; needs newton[sim], trimesh and scipy. Prints JSON.

python read_in_newton.py EXPORT SECONDS; see test_export_newton.
"""

import json
import sys

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
sys.path.insert(0, folder)

import cluttergen_newton
import newton
import numpy as np
import warp

warp.set_device("cpu")
builder = newton.ModelBuilder()
worlds = cluttergen_newton.add_worlds(builder)
model = builder.finalize()
before = model.state()
after = model.state()
control = model.control()
newton.eval_fk(model, model.joint_q, model.joint_qd, before)
solver = cluttergen_newton.make_solver(model)
option = solver.mj_model.opt
start = before.body_q.numpy().copy()
mass = model.body_mass.numpy()
num_steps = round(seconds * 480)
for _ in range(num_steps):
    before.clear_forces()
    solver.step(before, after, control, None, 1 / 480)
    before, after = after, before
end = before.body_q.numpy()
shift = np.linalg.norm((end - start)[:, :3], axis=1)
report = [
    {
        # Newton's quaternions are xyzw.
        "poses": {
            name: start[body, [0, 1, 2, 6, 3, 4, 5]].tolist() for name, body in world.items()
        },
        "mass": {name: float(mass[body]) for name, body in world.items()},
        "shift": {name: float(shift[body]) for name, body in world.items()},
    }
    for world in worlds
]
print(
    json.dumps(
        {
            "worlds": report,
            "finite": bool(np.isfinite(end).all()),
            "cone": int(option.cone),
            "version": newton.__version__,
        }
    )
)
