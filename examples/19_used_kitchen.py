# %% [markdown]
# # A kitchen that somebody uses
# Somebody has put things away: some stand on the worktop, some in the drawer, the mug behind a closed door.
# "Fetch the mug from the cupboard" begins here.

# %%
from pathlib import Path

import mujoco

import cluttergen_jax as cg
from cluttergen_jax.rendering import CameraView

num_scenes = 8

# %% [markdown]
# Objects are placed with doors and drawer open. Then these are closed slowly in physics, and a scene succeeds
# if they close and nothing is disturbed. Your own furniture works alike: `cluttergen import --support FILE`
# opens what hides a shelf. From the command line:
#
#     cluttergen generate --pool dining~bottle --support cupboard --surface shelf_1:3,drawer:2,top:2

# %%
if __name__ == "__main__":
    bank = cg.generate(
        "kitchen",
        pool="dining~bottle",
        objects=("mug", "bowl", "fork", "soup_can", "dinner_plate", "water_glass", "pepper_mill"),
        support="cupboard",
        surface="shelf_1:3,drawer:2,top:2",
        num_scenes=num_scenes,
    )
    print(bank)

# %% [markdown]
# Where is the mug? The open scene has what is in the drawer outside.

# %%
if __name__ == "__main__":
    for number, scene in enumerate(cg.read_scenes(bank)):
        index = scene.names.index("mug")
        height = scene.poses[index, 2]
        where = "on top" if height > 0.9 else "in the drawer" if height > 0.7 else "behind a door"
        out = scene.poses[index, 1] - scene.open_doors().poses[index, 1]
        print(
            f"scene {number}: the mug is {where}, and comes {out:.2f} m forward with what is opened"
        )
    view = CameraView(azimuth=112, elevation=-16)
    for doors in ("closed", "open"):
        cg.render("kitchen", f"pictures/{doors}", scenes="2", doors=doors, view=view, whole=True)

# %% [markdown]
# ![The kitchen with its doors closed, and the same with them open](../docs/images/tutorials/used_kitchen.png)
#
# A robot has to open the door itself: in exports with `joints` doors and drawers move, and stay closed
# until they are pulled.

# %%
if __name__ == "__main__":
    cg.export(bank.path, "exported", joints=True, overwrite=True)
    model = mujoco.MjModel.from_xml_path(str(min(Path("exported/scenes").glob("*.xml"))))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(10 / model.opt.timestep))
    joints = [model.joint(j) for j in range(model.njnt) if model.jnt_type[j] != 0]
    for joint in joints:
        print(f"{joint.name} after ten seconds: {data.joint(joint.name).qpos[0]:.4f}")

# %% [markdown]
# `cluttergen stats kitchen` says which door hit what, where one did. Definitions:
# [doors](../docs/contract.md#success).
