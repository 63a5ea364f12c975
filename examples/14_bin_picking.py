# %% [markdown]
# # Bin-picking data in ten minutes
# Objects are thrown into a bin until they lie still, and two depth cameras look at them: what instance
# segmentation, pose estimation and grasp detection are trained on. No training, no GPU.

# %%
import io
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.rendering.picture import distinct_colour
from cluttergen_jax.rendering.sheet import contact_sheet, save_png

num_scenes = 200
num_objects = 15

# %% [markdown]
# Each object is released in a random orientation between walls of air; then the walls are taken away and all
# is simulated until nothing moves. A pile that never comes to rest is no success, and is not used below.
# Your own objects: `cg.import_pool("my_meshes", "mine")`, then `pool="mine"`.

# %%
if __name__ == "__main__":
    piles = cg.SceneSpec(
        pool="all",
        objects=("width<0.2 and height<0.2",),
        num_objects=num_objects,
        support="bin",
        method="pile",
    )
    bank = cg.generate("bin", piles, num_scenes=num_scenes, render=False)
    print(bank)

# %% [markdown]
# The first camera is where a bin-picking cell has it; the other one is somewhere else for each scene. Depth
# and labels come from rays and need no OpenGL; `colour=False` leaves out the colours, which do.

# %%
CAMERAS = {
    "cameras": [
        {"name": "above", "fovy": 50, "eye": [0.0, -0.05, 0.75]},
        {
            "name": "beside",
            "fovy": 45,
            "azimuth": [0, 360],
            "elevation": [45, 70],
            "distance": [0.6, 0.8],
        },
    ]
}

if __name__ == "__main__":
    Path("cameras.json").write_text(json.dumps(CAMERAS))
    seen = {"cameras": ("cameras.json",), "size": "320x240", "vary": ("light", "colour")}
    print(cg.make_dataset("bin", "views", splits="train=0.8,val=0.1,test=0.1", **seen))

# %% [markdown]
# A row is a view: pictures, boxes, whole silhouettes, visible shares, poses in the camera's frame.

# %%
if __name__ == "__main__":
    rows = pq.read_table(sorted(Path("views").glob("train-*.parquet"))[0]).slice(0, 4).to_pylist()
    print(", ".join(rows[0]))
    images = []
    for row in rows:
        cells = (row["rgb"], row["label"])
        rgb, label = (np.array(Image.open(io.BytesIO(each["bytes"]))) for each in cells)
        masks = rgb.copy()
        for number in np.unique(label[label >= 2]):
            colour = 255 * np.array(distinct_colour(int(number) - 2)[:3])
            masks[label == number] = (0.4 * rgb[label == number] + 0.6 * colour).astype(np.uint8)
        images += [rgb, masks]
    save_png(contact_sheet(images, ["colour", "objects"] * len(rows), columns=4), Path("views.png"))

# %% [markdown]
# ![Four views of bins, and the objects that are seen](../docs/images/tutorials/bins.png)
#
# More: [piles, bins, shelves](../docs/guide/clutter.md), [datasets](../docs/guide/datasets.md) with a torch
# `DataLoader`. `cluttergen verify bin` lets the scenes stand for ten seconds.
