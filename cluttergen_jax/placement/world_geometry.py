"""The compiled world's objects as arrays."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.assets.height_profile import HeightProfile
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.physics.margin import support_margin
from cluttergen_jax.placement.support_map import map_of_surfaces
from cluttergen_jax.placement.types import Geometry, Orientations
from cluttergen_jax.placement.world import World

_RUN = 64
_TOUCHING = 1e-4


def on_device(arrays: Any) -> Any:
    """A pytree of NumPy arrays as JAX's, f64 as f32.

    They are moved as they are: `jnp.asarray` would compile a program for each shape.
    """
    narrowed = jax.tree.map(lambda a: a.astype(np.float32) if a.dtype == np.float64 else a, arrays)
    return jax.device_put(narrowed)


def geometry_of(world: World, orientations: Orientations | None = None) -> Geometry:
    """The world's objects as arrays, columns padded to the longest.

    Args:
      orientations: in which they are released; None for upright.
    """
    most = max(len(columns.sample) for columns in world.columns)

    def pad(arrays: list[np.ndarray]) -> np.ndarray:
        return np.stack([np.pad(a, [(0, most - len(a))] + [(0, 0)] * (a.ndim - 1)) for a in arrays])

    runs = [surface_runs(columns.surface) for columns in world.columns]
    owner = np.repeat(np.arange(len(runs), dtype=np.int32), [len(run) for run in runs])
    boxes = [(*box.center, *box.half_extents, box.yaw) for box in world.support.boxes]
    found = Geometry(
        half_extents=np.stack([asset.half_extents for asset in world.objects]),
        center_of_mass=world.layout.center_of_mass,
        own_margin=np.array([own_margin_of(asset) for asset in world.objects]),
        cloud=np.stack([asset.cloud for asset in world.objects]),
        column_xy=pad([columns.xy[columns.sample] for columns in world.columns]),
        column_bottom=pad([columns.bottom[columns.sample] for columns in world.columns]),
        is_column=pad([np.ones(len(columns.sample), bool) for columns in world.columns]),
        surface=np.concatenate(runs),
        surface_owner=owner,
        boxes=np.array(boxes).reshape(-1, 7),
        top=np.array(world.support.top),
        orientations=orientations,
        support_map=map_of_surfaces(world.support),
    )
    return on_device(found)


def pad_geometry(geometry: Geometry, num_columns: int, num_runs: int) -> Geometry:
    """The same objects in longer arrays: columns that are none, and runs of surface that come again.

    Raises:
      ValueError: they are longer already.
    """
    if geometry.orientations is not None:
        return geometry.replace(orientations=_padded(geometry.orientations, num_columns, num_runs))
    columns = num_columns - geometry.is_column.shape[1]
    runs = num_runs - len(geometry.surface)
    if min(columns, runs) < 0:
        raise ValueError(f"{-columns} columns or {-runs} runs of surface too many")
    again = jnp.minimum(jnp.arange(num_runs), len(geometry.surface) - 1)
    return geometry.replace(
        column_xy=jnp.pad(geometry.column_xy, ((0, 0), (0, columns), (0, 0))),
        column_bottom=jnp.pad(geometry.column_bottom, ((0, 0), (0, columns))),
        is_column=jnp.pad(geometry.is_column, ((0, 0), (0, columns))),
        surface=geometry.surface[again],
        surface_owner=geometry.surface_owner[again],
    )


def _padded(found: Orientations, num_columns: int, num_runs: int) -> Orientations:
    columns = num_columns - found.is_column.shape[2]
    again = jnp.minimum(jnp.arange(num_runs), len(found.surface) - 1)
    return found.replace(
        column_xy=jnp.pad(found.column_xy, ((0, 0), (0, 0), (0, columns), (0, 0))),
        column_bottom=jnp.pad(found.column_bottom, ((0, 0), (0, 0), (0, columns))),
        is_column=jnp.pad(found.is_column, ((0, 0), (0, 0), (0, columns))),
        surface=found.surface[again],
        surface_owner=found.surface_owner[again],
    )


def own_margin_of(asset: ObjectAsset) -> float:
    """Metres: the support margin of an object that stands in its own frame on a flat table."""
    vertices = np.concatenate([part.vertices for part in asset.parts])
    bottom = vertices[vertices[:, 2] < vertices[:, 2].min() + _TOUCHING]
    return support_margin(bottom[:, :2] - asset.center_of_mass[:2])


def num_runs_of(columns: HeightProfile) -> int:
    """In how many runs an object's upper surface stands in `Geometry.surface`."""
    return -(-len(columns.surface) // _RUN)


def surface_runs(surface: np.ndarray) -> np.ndarray:
    """f64[M, 64, 3]: an object's grown upper surface, padded with its first point."""
    padding = np.repeat(surface[:1], -len(surface) % _RUN, axis=0)
    return np.concatenate([surface, padding]).reshape(-1, _RUN, 3)
