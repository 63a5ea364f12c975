# %% [markdown]
# # From your own meshes to a pool
# The first half of the guide from own meshes to own policy; 03 is the second. Any folder of OBJ, STL, PLY,
# GLB, DAE, URDF, SDF or MJCF files will do. Here three meshes are made up, as if they had been downloaded.

# %%
from pathlib import Path

import trimesh

import cluttergen_jax as cg
from cluttergen_jax.rendering.assets import object_sheet
from cluttergen_jax.rendering.sheet import save_png

# %% [markdown]
# Files are in metres and z is up, or say otherwise (`scale`, `up`). A file that betrays another unit is
# refused with a proposal.


# %%
def make_meshes(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    trimesh.creation.cylinder(0.03, 0.12).export(folder / "tin.obj")
    trimesh.creation.box((0.16, 0.11, 0.03)).export(folder / "box_of_tea.stl")
    ring = trimesh.creation.annulus(0.025, 0.04, 0.05)
    ring.export(folder / "napkin_ring.ply")


# %% [markdown]
# Importing closes each mesh, cuts it into convex parts, lets it settle, and measures how stable it is and
# how far the parts are from the surface. It runs in worker processes, hence the guard. The same from the
# command line:
#
#     cluttergen import my_meshes/ --pool my_pool
#     cluttergen inspect my_pool --out my_pool.png
#
# Your own table too: `cluttergen import --support my_table.obj`, then `--support my_table`.

# %%
if __name__ == "__main__":
    make_meshes(Path("my_meshes"))
    report = cg.import_pool("my_meshes", "my_pool")
    for failure in report.failures:
        print(f"not imported: {failure.name}: {failure.reason}")
    for asset in report.pool.objects:
        parts = len(asset.parts)
        solo = asset.quality.solo_rate
        print(
            f"{asset.name}: {parts} convex parts, {asset.mass:.3f} kg, stable in {solo:.0%} of its trials"
        )
        print(f"  {'; '.join(asset.flags) or 'nothing to remark'}")
    save_png(object_sheet(report.pool.objects, columns=3), "my_pool.png")

# %% [markdown]
# It prints (below the progress of the import):
#
#     box_of_tea: 1 convex parts, 0.264 kg, stable in 100% of its trials
#       nothing to remark
#     napkin_ring: 8 convex parts, 0.076 kg, stable in 100% of its trials
#       nothing to remark
#     tin: 1 convex parts, 0.169 kg, stable in 100% of its trials
#       nothing to remark
#
# and draws `my_pool.png`, each object beside its collision parts:
#
# ![Three objects and their parts](../docs/images/tutorials/my_pool.png)
