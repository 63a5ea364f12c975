# %% [markdown]
# # A bank: thousands of scenes on disk, verified
# The same as `cluttergen generate`, `verify` and `stats`, from Python. If it is interrupted, run it again:
# it resumes.

# %%
import numpy as np

import cluttergen_jax as cg

num_scenes, num_objects = 200, 10

# %%
bank = cg.generate(
    "bank", pool="dining", num_scenes=num_scenes, num_objects=num_objects, method="clear",
    max_files=20,
)  # fmt: skip
print(bank)

# %% [markdown]
# Each saved file (at most `max_files`) is reloaded in plain MuJoCo and simulated for ten seconds with
# sleeping disabled.

# %%
report = cg.verify("bank")
print(report)
assert report.is_sound

# %%
print(cg.stats_text(bank, cg.stats_of(bank)))

# %% [markdown]
# A row per scene, failures included, in Parquet: pandas, Polars, DuckDB read it too. `bank/README.md`
# explains every column.

# %%
table = bank.table.select(["is_success", "num_placed", "simulated_steps"])
print(table.schema)
print(f"median steps simulated for a scene: {np.median(table['simulated_steps']):.0f}")

# %%
scene = next(scene for scene in bank.scenes() if scene.is_success)
for name, pose in zip(scene.objects, scene.poses, strict=True):
    print(f"{name:14} at {np.round(pose[:3], 3)} m, turned {np.round(pose[3:], 3)}")

# %% [markdown]
# A picture of six scenes, `pictures/bank-sheet.png`:

# %%
cg.render("bank", "pictures", scenes="0-5", picture=False, sheet=True, columns=3)
