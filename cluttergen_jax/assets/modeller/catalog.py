"""All families and pools of the modeller in one place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cluttergen_jax.assets.modeller import (
    containers,
    electronics,
    homeware,
    kitchenware,
    stationery,
)
from cluttergen_jax.assets.modeller.draw import Draw, Family, made_by
from cluttergen_jax.assets.shape import Shape
from cluttergen_jax.errors import PoolError

_POOLS: dict[str, tuple[Family, ...]] = {
    # What stands on a laid table.
    "dining": (
        kitchenware.mug,
        kitchenware.bowl,
        kitchenware.dinner_plate,
        kitchenware.water_glass,
        kitchenware.wine_glass,
        containers.bottle,
        containers.soup_can,
        containers.cereal_box,
        kitchenware.pepper_mill,
        kitchenware.fork,
    ),
    # What lies on a worktop.
    "kitchen": (
        kitchenware.pot,
        kitchenware.frying_pan,
        kitchenware.teapot,
        kitchenware.colander,
        kitchenware.toaster,
        containers.jar,
        containers.milk_carton,
        kitchenware.knife,
        kitchenware.wooden_spoon,
        kitchenware.cutting_board,
    ),
    # What stands about on a study's desk.
    "study": (
        stationery.hardback_book,
        homeware.desk_lamp,
        electronics.alarm_clock,
        electronics.camera,
        homeware.globe,
        electronics.laptop,
        electronics.mouse,
        stationery.stapler,
        homeware.eyeglasses,
        containers.pencil_cup,
    ),
    # What is worked with at a desk.
    "office": (
        electronics.keyboard,
        electronics.calculator,
        stationery.tape_dispenser,
        stationery.scissors,
        containers.pen_holder,
        electronics.desk_phone,
        containers.letter_tray,
        stationery.hole_punch,
        stationery.sticky_notes,
        stationery.ring_binder,
    ),
    # What is found about the house.
    "household": (
        homeware.tissue_box,
        homeware.tape_roll,
        homeware.spray_bottle,
        homeware.candle,
        homeware.flower_pot,
        electronics.remote_control,
        homeware.toy_car,
        homeware.soap_dispenser,
        homeware.photo_frame,
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
    shape = FAMILIES[family](Draw(None if seed is None else np.random.default_rng(seed)))
    return replace(
        shape,
        name=family if seed is None else f"{family}-{seed}",
        label=shape.label or family.replace("_", " "),
        provenance=made_by(family),
    )
