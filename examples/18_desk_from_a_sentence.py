# %% [markdown]
# # A messy desk from one sentence
# A language model writes a layout; its errors are sent back, four times at most; then scenes are made. It
# is a command that reads a prompt and prints an answer, or the URL of a chat endpoint. Here a stub stands for
# one, so that you need neither: it misspells an object, then a relation, and then is right.

# %%
import sys
from pathlib import Path

import cluttergen_jax as cg

num_scenes = 16

STUB = '''
import sys

layout = """
title: A messy desk
support: table-1.20x0.70
objects:
  {laptop: laptop, mouse: mouse, coffee: mug, book: hardback_book, atlas: hardback_book, glasses: eyeglasses,
   phone: desk_phone, notes: sticky_notes, pens: pen_holder, calculator: calculator, stapler: stapler}
relations:
  - mouse right_of laptop:0.08
  - coffee left_of laptop:0.12
  - atlas on book
  - glasses on atlas
  - pens behind laptop:0.15
  - notes next_to phone:0.04
natural: true
crowd: 0.25
"""
prompt = sys.stdin.read()
if "Your last answer was" not in prompt:
    layout = layout.replace(": sticky_notes", ": post_its")
elif "post_its" in prompt:
    layout = layout.replace("next_to phone", "beside phone")
print("Here is your desk:\\n```yaml" + layout + "```")
'''

# %% [markdown]
# The model gets the JSON schema of a layout (`cluttergen layout --schema`), the pool's objects with their
# sizes, and the sentence. `desk.answers.json` keeps every answer with its errors, and their places:
#
#     objects.notes: 'post_its', which no object of pool 'office+study+dining' is. Allowed: keyboard, ...
#     relations[5]: 'beside' in relation 'notes beside phone:0.04'. Did you mean 'notes next_to phone:0.04'?

# %%
if __name__ == "__main__":
    Path("my_model.py").write_text(STUB)
    model = f"{sys.executable} my_model.py"
    pool = "office+study+dining"
    asked = cg.layout.ask("a messy desk", model, "desk.yaml", pool=pool, overwrite=True)
    print(asked)
    print(cg.layout.check("desk.yaml"))
    bank = cg.generate("desk", layout="desk.yaml", num_scenes=num_scenes, overhang="half")
    print(bank)
    cg.render("desk", "pictures", picture=False, sheet=True, columns=4)

# %% [markdown]
# ![Messy desks](../docs/images/tutorials/messy_desk.png)
#
# The same in one command, and with a model behind an endpoint, whose key is in the variable `MY_KEY`:
#
#     cluttergen layout ask "a messy desk" --model "python my_model.py" --pool office+study+dining --out desk
#     cluttergen layout ask "a messy desk" --model http://localhost:8000/v1 --model-name NAME --key-env MY_KEY
#
# The bank's record and card name the sentence, the model, and how many answers it took. More:
# [layouts](../docs/guide/clutter.md#layouts).
