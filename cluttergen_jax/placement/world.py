"""The compiled world: objects and a support as one MuJoCo model, every object free and parked."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from cluttergen_jax.assets.height_profile import HeightProfile, height_profile_of
from cluttergen_jax.assets.mjcf import add_air_walls, populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics.layout import Layout

MAX_OBJECTS = 200
COLUMN_SPACING = 0.0035
NUM_COLUMN_SAMPLES = 512


@dataclass(frozen=True, eq=False)
class World:
    """K objects that can be placed on one support; meshes are fixed from here on.

    Attributes:
      names: unique, in the order of the object index.
      objects: the assets, one for each index (an asset may stand there more than once).
      support: the table.
      layout: the compiled model and what belongs to what.
      columns: each object seen from above.
    """

    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    support: SupportAsset
    layout: Layout
    columns: tuple[HeightProfile, ...]

    @property
    def num_objects(self) -> int:
        """K."""
        return len(self.objects)


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names made unique by a number: mug, mug#2, mug#3."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}#{seen[name]}")
    return tuple(result)


def base_name(name: str) -> str:
    """The asset's name behind a unique one: mug of mug#3."""
    return re.sub(r"#\d+$", "", name)


def repeat_objects(objects: Sequence[ObjectAsset], num_objects: int) -> tuple[ObjectAsset, ...]:
    """The objects over again until there are at least `num_objects`, each equally often."""
    return tuple(objects) * -(-num_objects // len(objects))


def columns_of(asset: ObjectAsset) -> HeightProfile:
    """An asset's columns as worlds have them."""
    return height_profile_of(asset, COLUMN_SPACING, NUM_COLUMN_SAMPLES)


def compile_layout(
    names: Sequence[str],
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    stability: StabilityConfig,
    contact: ContactConfig,
) -> Layout:
    """Objects and a support as one model."""
    make_spec = partial(populated_spec, names, objects, support, stability.timestep, contact)
    model = make_spec().compile()

    def compile_walled() -> mujoco.MjModel:
        spec = make_spec()
        add_air_walls(spec)
        return spec.compile()

    # Bodies keep their parking place as qpos0, at the identity orientation.
    assert np.all(model.qpos0.reshape(-1, 7)[:, 3] == 1.0)
    return Layout.of(model, support.lowest, compile_walled)


def make_world(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    stability: StabilityConfig,
    contact: ContactConfig,
    cut: Callable[[ObjectAsset], HeightProfile] = columns_of,
) -> World:
    """Compiles a world.

    Args:
      cut: makes each asset's columns; whoever makes many worlds of the same objects keeps them.

    Raises:
      ConfigError: there are no objects, or more than MAX_OBJECTS.
    """
    if not 1 <= len(objects) <= MAX_OBJECTS:
        raise ConfigError(
            f"a world of {len(objects)} objects", f"1 to {MAX_OBJECTS}", "a smaller pool"
        )
    names = unique_names([asset.name for asset in objects])
    columns = {id(asset): cut(asset) for asset in objects}
    return World(
        names=names,
        objects=tuple(objects),
        support=support,
        layout=compile_layout(names, objects, support, stability, contact),
        columns=tuple(columns[id(asset)] for asset in objects),
    )
