"""All families and pools of the modeller in one place."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from cluttergen_jax.assets.modeller import (
    bathroom,
    computing,
    containers,
    cookware,
    curios,
    gadgets,
    homeware,
    lamps,
    organizers,
    paper,
    stationery,
    tableware,
    utensils,
)
from cluttergen_jax.assets.modeller.draw import Family
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.errors import PoolError

_POOLS: Mapping[str, Mapping[str, Family]] = {
    # What stands on a laid table.
    "dining": {
        "mug": tableware.mug,
        "bowl": tableware.bowl,
        "dinner_plate": tableware.dinner_plate,
        "water_glass": tableware.water_glass,
        "wine_glass": tableware.wine_glass,
        "bottle": containers.bottle,
        "soup_can": containers.soup_can,
        "cereal_box": containers.cereal_box,
        "pepper_mill": tableware.pepper_mill,
        "fork": utensils.fork,
    },
    # What lies on a worktop.
    "kitchen": {
        "pot": cookware.pot,
        "frying_pan": cookware.frying_pan,
        "teapot": tableware.teapot,
        "colander": cookware.colander,
        "toaster": cookware.toaster,
        "jar": containers.jar,
        "milk_carton": containers.milk_carton,
        "knife": utensils.knife,
        "wooden_spoon": utensils.wooden_spoon,
        "cutting_board": utensils.cutting_board,
    },
    # What stands about on a study's desk.
    "study": {
        "hardback_book": paper.hardback_book,
        "desk_lamp": lamps.desk_lamp,
        "alarm_clock": gadgets.alarm_clock,
        "camera": gadgets.camera,
        "globe": curios.globe,
        "laptop": computing.laptop,
        "mouse": computing.mouse,
        "stapler": stationery.stapler,
        "eyeglasses": curios.eyeglasses,
        "pencil_cup": organizers.pencil_cup,
    },
    # What is worked with at a desk.
    "office": {
        "keyboard": computing.keyboard,
        "calculator": computing.calculator,
        "tape_dispenser": stationery.tape_dispenser,
        "scissors": stationery.scissors,
        "pen_holder": organizers.pen_holder,
        "desk_phone": computing.desk_phone,
        "letter_tray": organizers.letter_tray,
        "hole_punch": stationery.hole_punch,
        "sticky_notes": paper.sticky_notes,
        "ring_binder": paper.ring_binder,
    },
    # What is found about the house.
    "household": {
        "tissue_box": homeware.tissue_box,
        "tape_roll": homeware.tape_roll,
        "spray_bottle": bathroom.spray_bottle,
        "candle": lamps.candle,
        "flower_pot": homeware.flower_pot,
        "remote_control": gadgets.remote_control,
        "toy_car": curios.toy_car,
        "soap_dispenser": bathroom.soap_dispenser,
        "photo_frame": curios.photo_frame,
        "basket": homeware.basket,
    },
}

FAMILIES: dict[str, Family] = {name: family for pool in _POOLS.values() for name, family in pool.items()}
POOLS: dict[str, tuple[str, ...]] = {pool: tuple(families) for pool, families in _POOLS.items()}


def make_shape(family: str, seed: int | None = None) -> Shape:
    """An object of a family.

    Args:
      family: a key of `FAMILIES`.
      seed: None for the canonical proportions; equal seeds give equal shapes, named `family-seed`.

    Raises:
      PoolError: there is no such family.
    """
    if family not in FAMILIES:
        raise PoolError(f"no family named {family!r}", ", ".join(sorted(FAMILIES)), "one of these names")
    if seed is None:
        return FAMILIES[family](None)
    shape = FAMILIES[family](np.random.default_rng(seed))
    return dataclasses.replace(shape, name=f"{shape.name}-{seed}")
