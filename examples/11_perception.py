# %% [markdown]
# # From a picture to poses
# One colour and depth image from files, and the poses of the objects in it (extra `perception`). The files
# could come from a real camera; here they are rendered first, so that the answer can be compared.

# %%
from pathlib import Path

import numpy as np
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.downstream.perception.finder import SceneFinder
from cluttergen_jax.downstream.perception.frames import Frame, read_frame, write_frame
from cluttergen_jax.downstream.perception.segmenter import embedded_segmenters, load_segmenter
from cluttergen_jax.downstream.perception.types import Segmentation
from cluttergen_jax.downstream.robot.cameras import FOCAL, SIZE
from cluttergen_jax.rendering import PictureConfig
from cluttergen_jax.sensing import free
from cluttergen_jax.views import ViewMaker

num_objects = 8
folder = Path("frame")

# %% [markdown]
# A successful scene, seen by a camera beside the table: colours, depths with noise, and the camera, whose
# stated pose errs by some millimetres. Labels are written too, for those who have no segmenter.

# %%
bank = cg.generate(
    "seen", pool="household", num_scenes=2, num_objects=num_objects, max_files=0, render=False
)
scene = next(iter(cg.read_scenes(bank)))
pool = cg.load_pool("household").objects
placed = dict(zip(scene.names, scene.poses, strict=True))
rng = np.random.default_rng(1)
with ViewMaker(PictureConfig(*SIZE)) as maker:
    maker.place(scene.objects, scene.poses, scene.support)
    seen = maker.see(free(scene.support, rng, *SIZE, FOCAL))
# Of what each label stands for: the floor, the support, then the objects of the scene.
label_of = np.array([0, 0, *(2 + [each.name for each in pool].index(name) for name in scene.names)])
depth, camera = noisy(seen.depth, seen.camera, REALSENSE, rng)
write_frame(folder, Frame(seen.rgb, depth, camera))
Image.fromarray(label_of[seen.label].astype(np.uint8)).save(folder / "labels.png")

# %% [markdown]
# Whatever tells which pixel shows which object is a segmenter. In a checkout, `python -m studies.perception
# train` makes one; where none comes with the package, this one reads labels that another program wrote.


# %%
class FromFile:
    """Labels of an image file: 0 background, 1 arm, 2 + k the pool's object k."""

    names = tuple(asset.name for asset in pool)

    def __call__(self, rgb, depth, camera, among=None):
        label = np.asarray(Image.open(folder / "labels.png"))
        return Segmentation(self.names, label)


segmenter = load_segmenter("household") if "household" in embedded_segmenters() else FromFile()
finder = SceneFinder(pool, scene.support, segmenter)

# %% [markdown]
# The frame is read, looked at, and each object's pose is found by registration; the certainty is the chance
# that it is right to 5 mm and 5 degrees.

# %%
frame = read_frame(folder)
found = finder([finder.look(frame.rgb, frame.depth, frame.camera)])
for name, pose, is_seen, certainty in zip(
    found.names, found.pose, found.seen, found.certainty, strict=True
):
    if is_seen:
        x, y, z = pose[:3]
        off = (
            f"{1e3 * np.linalg.norm(pose[:3] - placed[name][:3]):.1f} mm"
            if name in placed
            else "not there"
        )
        print(
            f"{name} at {x:+.3f} {y:+.3f} {z:.3f} m, certainty {certainty:.2f}; from the true place: {off}"
        )
print(f"{found.seen.sum()} objects found, {len(placed)} on the table")

# %% [markdown]
# It prints:
#
#     tissue_box at -0.053 -0.155 0.771 m, certainty 0.98; from the true place: 3.0 mm
#     spray_bottle at +0.208 -0.036 0.810 m, certainty 0.96; from the true place: 2.1 mm
#     ...
#     8 objects found, 8 on the table
#
# What two noisy cameras see, the masks, and the poses that are found, drawn by
# `python -m docs.make_perception`:
#
# ![Four scenes, their masks and poses](../docs/images/perception.png)
