# %% [markdown]
# # From a library of objects to a dataset
# People have libraries: Google Scanned Objects, Objaverse, their own scans. Here two dozen meshes stand for
# one, with a table of their labels; a thousand go the same way, only the import takes longer.

# %%
import io
from pathlib import Path

import jax
import numpy as np
import pyarrow.parquet as pq
import trimesh
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.rendering.sheet import contact_sheet, save_png

num_meshes = 24
num_scenes = 512


def make_library(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(0)
    lines = ["file,label"]
    for number in range(num_meshes):
        width = rng.uniform(0.03, 0.07)
        height = rng.uniform(0.03, 0.14)
        box = trimesh.creation.box((width, 1.4 * width, height))
        tin = trimesh.creation.cylinder(width / 2, height)
        (box if number % 4 else tin).export(folder / f"scan_{number:03d}.obj")
        lines.append(f"scan_{number:03d}.obj,{'box' if number % 4 else 'tin'}")
    Path("labels.csv").write_text("\n".join(lines) + "\n")


# %% [markdown]
# The import is resumed where it was stopped, and tells what each object cost. `cluttergen inspect library
# --out library.html` makes a page to scroll through, flagged objects first.
#
# Each block of 256 scenes draws its own shelf of objects, here of eight. Three in four objects are boxes;
# with `balance="label"` half of a shelf are tins. From more than 200 objects there is a shelf unasked.

# %%
if __name__ == "__main__":
    make_library(Path("scans"))
    pool = cg.import_pool("scans", "library", settings="labels.csv").pool
    print(f"{len(pool)} objects, {sum(each.label == 'tin' for each in pool.facts)} tins")
    spec = cg.SceneSpec(
        "library", num_objects=5, shelf=8, balance="label", support="table-0.40x0.40"
    )
    bank = cg.generate("bank", spec, num_scenes=num_scenes, max_files=0)
    rows = bank.table.to_pydict()
    print(
        f"{sum(rows['is_success'])} of {num_scenes} scenes succeed, of {len(bank.object_names)} objects"
    )
    label = {each.name: each.label for each in pool.facts}
    tins = np.mean([label[name] == "tin" for names in rows["objects"] for name in names])
    print(f"{tins:.0%} of what stands there are tins")

# %% [markdown]
# In a program of one's own the sampler is an argument of what is compiled, which then serves every shelf.

# %%
if __name__ == "__main__":
    sample = cg.make_sampler(spec)
    many = jax.jit(lambda sample, keys: jax.vmap(sample)(keys))
    keys = jax.random.split(jax.random.key(0), 16)
    for key in jax.random.split(jax.random.key(1), 3):
        sample = sample.reshelve(key)
        print(
            f"{int(many(sample, keys).is_success.sum())} of 16 stand, of {', '.join(sample.names[:2])} ..."
        )
    print(f"compiled: {many._cache_size()}")

# %% [markdown]
# What two cameras see of each scene, one of them somewhere else every time. Table, light and colours vary;
# without OpenGL `colour=False` gives all but colours.

# %%
if __name__ == "__main__":
    seen = {
        "cameras": ("free", "overhead"),
        "size": "320x240",
        "vary": ("texture", "light", "colour"),
    }
    print(cg.make_dataset("bank", "views", num_scenes=6, splits="train=0.5,test=0.5", **seen))
    files = sorted(Path("views").glob("*.parquet"))
    found = [row for file in files for row in pq.read_table(file).to_pylist()]
    images = [np.array(Image.open(io.BytesIO(row["rgb"]["bytes"]))) for row in found]
    save_png(
        contact_sheet(images, [f"scene {row['scene']}, {row['camera']}" for row in found]),
        "views.png",
    )
    visible = np.concatenate([row["visible"] for row in found])
    print(
        f"{np.mean(visible > 0.9):.0%} of objects are seen almost whole, {np.mean(visible < 0.1):.0%} hardly"
    )

# %% [markdown]
# It prints (below the progress):
#
#     24 objects, 6 tins
#     512 of 512 scenes succeed, of 13 objects
#     49% of what stands there are tins
#     16 of 16 stand, of scan_000, scan_005 ...
#     (two more shelves)
#     compiled: 1
#     views      4 of train, 8 of test in views (parquet)
#     87% of objects are seen almost whole, 0% hardly
#
# and draws `views.png`. How a trainer reads the files: [guide](../docs/guide/datasets.md).
# ![Twelve views of six scenes](../docs/images/tutorials/views.png)
