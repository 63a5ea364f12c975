"""The pool `dining`: what stands on a laid table."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import cartons, containers, crockery, drinkware, millwork, utensils
from cluttergen_jax.assets.modeller.draw import Family

DINING: dict[str, Family] = {
    "mug": drinkware.mug,
    "bowl": crockery.bowl,
    "dinner_plate": crockery.dinner_plate,
    "water_glass": drinkware.water_glass,
    "wine_glass": drinkware.wine_glass,
    "bottle": containers.bottle,
    "soup_can": containers.soup_can,
    "cereal_box": cartons.cereal_box,
    "pepper_mill": millwork.pepper_mill,
    "fork": utensils.fork,
}
