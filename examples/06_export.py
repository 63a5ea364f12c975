# %% [markdown]
# # Scenes for other programs
# Self-contained folders: meshes, collision parts, masses, frictions, licences.

# %%
from pathlib import Path

import mujoco

import cluttergen_jax as cg

num_objects = 8

# %%
bank = cg.generate("bank_06", num_scenes=4, num_objects=num_objects, method="clear", max_files=0)

# %% [markdown]
# The same from the command line: `cluttergen export bank_06 --format urdf --out exported/urdf`.

# %%
for kind in ("mjcf", "urdf", "sdf", "glb"):
    print(f"{kind:5} {cg.export(bank.path, f'exported/{kind}', kind, overwrite=True)}")

# %%
first = min(Path("exported/mjcf/scenes").glob("*.xml"))
model = mujoco.MjModel.from_xml_path(str(first))
print(f"read back by MuJoCo: {model.nbody} bodies, {model.nmesh} meshes")

# %% [markdown]
# Into a model of your own: here a world with another time step, on a podium.

# %%
spec = mujoco.MjSpec()
spec.option.timestep = 0.002
spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(1, 1, 0.1), pos=(0, 0, 0.1))
place = next(cg.read_scenes(bank)).attach_to(spec, prefix="clutter/", position=(0, 0, 0.2))
model = spec.compile()
data = mujoco.MjData(model)
data.qpos[:] = place.qpos(model)
start = data.qpos.copy()
mujoco.mj_step(model, data, 500)
moved = abs(data.qpos - start).reshape(-1, 7)[:, :3].max()
print(f"after a second in your own world, the objects have moved {moved * 1000:.2f} mm at most")

# %% [markdown]
# It prints:
#
#     mjcf  exported/mjcf
#     urdf  exported/urdf
#     sdf   exported/sdf
#     glb   exported/glb
#     read back by MuJoCo: 10 bodies, 82 meshes
#     after a second in your own world, the objects have moved 0.00 mm at most
