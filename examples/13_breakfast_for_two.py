# %% [markdown]
# # Breakfast for two
# What shall stand where, in a few lines that a person or a language model can write: names, which objects of
# the pool each may stand for, and relations between them.

# %%
from pathlib import Path

import cluttergen_jax as cg

num_scenes = 16

BREAKFAST = """
title: Breakfast for two
pool: dining+kitchen
support: table-1.00x0.70
objects:
  {mine: dinner_plate, yours: dinner_plate, my_mug: mug, your_mug: mug, cereal: bowl, milk: milk_carton}
relations:
  - yours right_of mine:0.30
  - my_mug behind mine
  - your_mug behind yours
  - cereal on mine
  - milk next_to your_mug:0.10
others: 2
"""

# %% [markdown]
# Each scene fulfils every relation, stands by itself, and is another one. An attempt after which a relation
# does not hold ends `unrelated`; the search proposes poses where relations hold, so that this is rare.

# %%
if __name__ == "__main__":
    Path("breakfast.yaml").write_text(BREAKFAST)
    bank = cg.generate("bank", layout="breakfast.yaml", num_scenes=num_scenes)
    print(bank)
    cg.render("bank", "pictures", picture=False, sheet=True, columns=4)
    print(f"layouts that come with the package: {', '.join(cg.layout.list_layouts())}")

# %% [markdown]
# ![Eight breakfasts for two](../docs/images/tutorials/breakfast.png)
#
# Rules and definitions: [poses, relations, layouts](../docs/guide/clutter.md).
