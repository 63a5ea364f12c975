"""The compiled world: objects and a support as one MuJoCo model, every object free and parked; its arrays."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from cluttergen_jax.assets.doors import Doors
from cluttergen_jax.assets.height_profile import HeightProfile, height_profile_of
from cluttergen_jax.assets.mjcf import add_air_walls, populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import support_margin
from cluttergen_jax.placement.doors import door_layout
from cluttergen_jax.placement.heightmap import map_of_surfaces
from cluttergen_jax.placement.types import Geometry, Orientations

MAX_OBJECTS = 200
COLUMN_SPACING = 0.0035
NUM_COLUMN_SAMPLES = 512
_RUN = 64
_TOUCHING = 1e-4


@dataclass(frozen=True, eq=False)
class World:
    """K objects that can be placed on one support; meshes are fixed from here on.

    Attributes:
      names: unique, in the order of the object index.
      objects: the assets, one for each index (an asset may stand there more than once).
      support: the table.
      layout: the compiled model and what belongs to what.
      columns: each object seen from above.
      doors: of the table, which are closed when all objects are placed; None where none are.
    """

    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    support: SupportAsset
    layout: Layout
    columns: tuple[HeightProfile, ...]
    doors: Doors | None = None

    @property
    def finished_support(self) -> SupportAsset:
        """The table as finished scenes have it."""
        return self.support if self.doors is None else self.doors.closed

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
    doors: Doors | None = None,
) -> Layout:
    """Objects and a support, with its doors open if it has some that close, as one model."""
    make_spec = partial(populated_spec, names, objects, support, stability.timestep, contact)
    model = make_spec().compile()

    def compile_walled() -> mujoco.MjModel:
        spec = make_spec()
        add_air_walls(spec)
        return spec.compile()

    # Bodies keep their parking place as qpos0, at the identity orientation.
    assert np.all(model.qpos0.reshape(-1, 7)[:, 3] == 1.0)
    layout = Layout.of(model, support.lowest, compile_walled)
    if doors is None:
        return layout
    closed = compile_layout(names, objects, doors.closed, stability, contact)

    def compile_moving() -> mujoco.MjModel:
        return make_spec(doors=doors.numbers).compile()

    return replace(layout, doors=door_layout(doors, closed, compile_moving))


def make_world(
    objects: Sequence[ObjectAsset],
    support: SupportAsset,
    stability: StabilityConfig,
    contact: ContactConfig,
    cut: Callable[[ObjectAsset], HeightProfile] = columns_of,
    doors: Doors | None = None,
) -> World:
    """Compiles a world.

    Args:
      doors: of the support, which is the open one then.
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
        layout=compile_layout(names, objects, support, stability, contact, doors),
        columns=tuple(columns[id(asset)] for asset in objects),
        doors=doors,
    )


def on_device(arrays: Any) -> Any:
    """A pytree of NumPy arrays as JAX's, f64 as f32.

    They are moved as they are: `jnp.asarray` would compile a program for each shape.
    """
    narrowed = jax.tree.map(lambda a: a.astype(np.float32) if a.dtype == np.float64 else a, arrays)
    return jax.device_put(narrowed)


def pad_rows(array: np.ndarray, length: int) -> np.ndarray:
    """An array with zeros behind its first axis, up to a length."""
    return np.pad(array, [(0, length - len(array))] + [(0, 0)] * (array.ndim - 1))


def geometry_of(world: World, orientations: Orientations | None = None) -> Geometry:
    """The world's objects as arrays, columns padded to the longest.

    Args:
      orientations: in which they are released; None for upright.
    """
    samples = [columns.sample for columns in world.columns]
    most = max(map(len, samples))
    column_xy = []
    column_bottom = []
    for columns in world.columns:
        column_xy.append(pad_rows(columns.xy[columns.sample], most))
        column_bottom.append(pad_rows(columns.bottom[columns.sample], most))
    runs = [surface_runs(columns.surface) for columns in world.columns]
    owner = np.repeat(np.arange(len(runs), dtype=np.int32), [len(run) for run in runs])
    support = world.support if world.doors is None else world.doors.with_obstacles
    boxes = [(*box.center, *box.half_extents, box.yaw) for box in support.boxes]
    found = Geometry(
        half_extents=np.stack([asset.half_extents for asset in world.objects]),
        center_of_mass=world.layout.center_of_mass,
        own_margin=np.array([own_margin_of(asset) for asset in world.objects]),
        cloud=np.stack([asset.cloud for asset in world.objects]),
        column_xy=np.stack(column_xy),
        column_bottom=np.stack(column_bottom),
        is_column=np.arange(most) < np.array([len(sample) for sample in samples])[:, None],
        surface=np.concatenate(runs),
        surface_owner=owner,
        boxes=np.array(boxes).reshape(-1, 7),
        top=np.array(world.support.top),
        orientations=orientations,
        support_map=map_of_surfaces(support),
    )
    return on_device(found)


def pad_geometry(geometry: Geometry, num_columns: int, num_runs: int) -> Geometry:
    """The same objects in longer arrays: columns that are none, and runs of surface that come again.

    Raises:
      ValueError: they are longer already.
    """
    found: Any = geometry.orientations or geometry
    columns = num_columns - found.is_column.shape[-1]
    runs = num_runs - len(found.surface)
    if min(columns, runs) < 0:
        raise ValueError(f"{-columns} columns or {-runs} runs of surface too many")
    again = jnp.minimum(jnp.arange(num_runs), len(found.surface) - 1)
    before = [(0, 0)] * (found.is_column.ndim - 1)
    longer = found.replace(
        column_xy=jnp.pad(found.column_xy, [*before, (0, columns), (0, 0)]),
        column_bottom=jnp.pad(found.column_bottom, [*before, (0, columns)]),
        is_column=jnp.pad(found.is_column, [*before, (0, columns)]),
        surface=found.surface[again],
        surface_owner=found.surface_owner[again],
    )
    return longer if found is geometry else geometry.replace(orientations=longer)


def own_margin_of(asset: ObjectAsset) -> float:
    """Metres: the support margin of an object that stands in its own frame on a flat table."""
    vertices = asset.vertices
    bottom = vertices[vertices[:, 2] < vertices[:, 2].min() + _TOUCHING]
    return support_margin(bottom[:, :2] - asset.center_of_mass[:2])


def num_runs_of(columns: HeightProfile) -> int:
    """In how many runs an object's upper surface stands in `Geometry.surface`."""
    return -(-len(columns.surface) // _RUN)


def surface_runs(surface: np.ndarray) -> np.ndarray:
    """f64[M, 64, 3]: an object's grown upper surface, padded with its first point."""
    padding = np.repeat(surface[:1], -len(surface) % _RUN, axis=0)
    return np.concatenate([surface, padding]).reshape(-1, _RUN, 3)
