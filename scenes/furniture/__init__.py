"""All supports of the modeller: the paper's cuboid, tables, furniture with several surfaces or a slope, and
containers on a table.

The boxes of tops, rims, risers, shelves and benches are where the surfaces are. Legs that lean are upright
boxes: nothing on the top touches them, and what falls past them has failed already.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from cluttergen_jax.assets.modeller.bins import SIZES, open_container
from cluttergen_jax.assets.modeller.draw import Draw
from cluttergen_jax.assets.support import SupportAsset, cuboid_table
from cluttergen_jax.errors import ConfigError, PoolError
from scenes.furniture.cupboards import cupboard
from scenes.furniture.desks import drawer_desk, l_desk, shelf_desk
from scenes.furniture.shelving import (
    bookcase,
    dish_rack,
    kitchen_drawer,
    rack,
    steps,
    tilted_board,
)
from scenes.furniture.tables import (
    bar_table,
    coffee_table,
    oval_table,
    picnic_table,
    round_table,
    tray_table,
    trestle_table,
)

CUBOID = "table"


def _cuboid(vary: Draw) -> SupportAsset:
    """The paper's table, or one of similar size."""
    return cuboid_table(vary(0.60), vary(0.70), vary(0.70, 0.05))


def _container(kind: str, vary: Draw) -> SupportAsset:
    """A bin of 0.40 x 0.30 x 0.15 m inside, as robots pick from; a tote, as warehouses have; a tray."""
    return open_container(kind, vary=vary)


SUPPORTS: dict[str, Callable[[Draw], SupportAsset]] = {
    CUBOID: _cuboid,
    "round_table": round_table,
    "oval_table": oval_table,
    "l_desk": l_desk,
    "tray_table": tray_table,
    "shelf_desk": shelf_desk,
    "trestle_table": trestle_table,
    "drawer_desk": drawer_desk,
    "coffee_table": coffee_table,
    "bar_table": bar_table,
    "picnic_table": picnic_table,
    "bookcase": bookcase,
    "rack": rack,
    "kitchen_drawer": kitchen_drawer,
    "cupboard": cupboard,
    "dish_rack": dish_rack,
    "tilted_board_5": partial(tilted_board, degrees=5),
    "tilted_board_10": partial(tilted_board, degrees=10),
    "steps": steps,
    **{kind: partial(_container, kind) for kind in SIZES},
}


def make_support(
    name: str, seed: int | None = None, size: tuple[float, ...] | None = None
) -> SupportAsset:
    """A support by name.

    Args:
      name: a key of `SUPPORTS`; "table" is the paper's cuboid.
      seed: None for the canonical proportions; equal seeds give equal supports, named `name-seed`.
      size: for "table" only: width, depth and perhaps height, metres.

    Raises:
      PoolError: there is no such support.
      ConfigError: a size that cannot be, or that was given for a piece of furniture or with a seed.
    """
    if name not in SUPPORTS:
        raise PoolError(f"no support named {name!r}", ", ".join(SUPPORTS), "one of these names")
    if size is not None:
        if name != CUBOID or seed is not None or len(size) not in (2, 3):
            raise ConfigError(
                f"size={size!r} for support {name!r} with seed {seed!r}",
                f"two or three lengths in metres, for {CUBOID!r} without a seed",
                "leaving size out",
            )
        return cuboid_table(*size)
    if seed is None:
        return SUPPORTS[name](Draw())
    support = SUPPORTS[name](Draw(np.random.default_rng(seed)))
    return replace(support, name=f"{support.name}-{seed}")
