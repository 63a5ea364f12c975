"""All families and pools of the modeller in one place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cluttergen_jax.assets.modeller import (
    computing,
    containers,
    cookware,
    curios,
    gadgets,
    homeware,
    organizers,
    stationery,
    tableware,
)
from cluttergen_jax.assets.modeller.draw import Family
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.errors import PoolError

_POOLS: dict[str, tuple[Family, ...]] = {
    # What stands on a laid table.
    "dining": (
        *(
            tableware.mug,
            tableware.bowl,
            tableware.dinner_plate,
            tableware.water_glass,
            tableware.wine_glass,
        ),
        *(
            containers.bottle,
            containers.soup_can,
            containers.cereal_box,
            tableware.pepper_mill,
            cookware.fork,
        ),
    ),
    # What lies on a worktop.
    "kitchen": (
        *(cookware.pot, cookware.frying_pan, tableware.teapot, cookware.colander, cookware.toaster),
        *(containers.jar, containers.milk_carton),
        *(cookware.knife, cookware.wooden_spoon, cookware.cutting_board),
    ),
    # What stands about on a study's desk.
    "study": (
        *(
            stationery.hardback_book,
            curios.desk_lamp,
            gadgets.alarm_clock,
            gadgets.camera,
            curios.globe,
        ),
        *(
            computing.laptop,
            computing.mouse,
            stationery.stapler,
            curios.eyeglasses,
            organizers.pencil_cup,
        ),
    ),
    # What is worked with at a desk.
    "office": (
        *(computing.keyboard, computing.calculator, stationery.tape_dispenser, stationery.scissors),
        *(
            organizers.pen_holder,
            computing.desk_phone,
            organizers.letter_tray,
            stationery.hole_punch,
        ),
        *(stationery.sticky_notes, stationery.ring_binder),
    ),
    # What is found about the house.
    "household": (
        *(
            homeware.tissue_box,
            homeware.tape_roll,
            homeware.spray_bottle,
            curios.candle,
            homeware.flower_pot,
        ),
        *(gadgets.remote_control, curios.toy_car, homeware.soap_dispenser, curios.photo_frame),
        homeware.basket,
    ),
}

FAMILIES: dict[str, Family] = {
    family.__name__: family for pool in _POOLS.values() for family in pool
}
POOLS = {pool: tuple(family.__name__ for family in families) for pool, families in _POOLS.items()}


def make_shape(family: str, seed: int | None = None) -> Shape:
    """An object of a family.

    Args:
      family: a key of `FAMILIES`.
      seed: None for the canonical proportions; equal seeds give equal shapes, named `family-seed`.

    Raises:
      PoolError: there is no such family.
    """
    if family not in FAMILIES:
        raise PoolError(
            f"no family named {family!r}", ", ".join(sorted(FAMILIES)), "one of these names"
        )
    if seed is None:
        return FAMILIES[family](None)
    shape = FAMILIES[family](np.random.default_rng(seed))
    return replace(shape, name=f"{shape.name}-{seed}")
