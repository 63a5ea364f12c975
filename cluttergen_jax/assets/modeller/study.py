"""The pool `study`: ten things from a study's desk."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cluttergen_jax.assets.modeller.lamps import desk_lamp
from cluttergen_jax.assets.modeller.paper import hardback_book
from cluttergen_jax.assets.shape import Shape

STUDY: dict[str, Callable[[np.random.Generator | None], Shape]] = {
    "hardback_book": hardback_book,
    "desk_lamp": desk_lamp,
}
