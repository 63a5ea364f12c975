"""The pool `kitchen`: what lies on a worktop."""

from __future__ import annotations

from cluttergen_jax.assets.modeller import appliances, cartons, containers, cookware, teapot, utensils
from cluttergen_jax.assets.modeller.draw import Family

KITCHEN: dict[str, Family] = {
    "pot": cookware.pot,
    "frying_pan": cookware.frying_pan,
    "teapot": teapot.teapot,
    "colander": cookware.colander,
    "toaster": appliances.toaster,
    "jar": containers.jar,
    "milk_carton": cartons.milk_carton,
    "knife": utensils.knife,
    "wooden_spoon": utensils.wooden_spoon,
    "cutting_board": utensils.cutting_board,
}
