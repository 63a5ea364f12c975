"""Which geoms of an MJCF body are its surface, which collide, and which are neither.

MuJoCo says of a geom whether it collides and whether it is drawn, but not whether what is drawn is the
object or a stand-in for collisions. So:

- Seen is what MuJoCo draws unasked: geoms in groups 0 to 2 whose colour has an alpha above 0. All others
  are helpers; they are never the surface as long as anything is seen.
- A seen geom that does not collide is surface. One that collides is surface too, such as a carton with a
  sticker, unless the former cover it: then it is their collision shape.
- Where nothing is seen, what collides is the surface.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.deviation import is_within_parts
from cluttergen_jax.assets.mesh import Mesh, joined
from cluttergen_jax.assets.parts import sound_points
from cluttergen_jax.importing.readers.mjcf_geoms import geom_kind, geom_mesh, geom_rgba, is_plane

_NUM_SEEN_GROUPS = 3
# What a geom stands in for fills its volume to this share at least, and ends nowhere sooner than it by more
# than this share of its size.
_FILLED = 1 / 3
_BEYOND = 0.05
_NUM_POINTS = 256
_MOST_NAMES = 5


@dataclass(frozen=True)
class Roles:
    """What the geoms of a body are there for.

    Attributes:
      surface: the geoms that are the object to the eye; empty if nothing is seen or collides.
      colliding: the geoms that collide, some of them perhaps surface as well.
      notes: what was decided, in words.
    """

    surface: tuple[int, ...]
    colliding: tuple[int, ...]
    notes: tuple[str, ...] = ()


def roles_of(model: mujoco.MjModel, data: mujoco.MjData, geoms: Iterable[int]) -> Roles:
    """The roles of one body's geoms, as they stand in `data`; planes have none."""
    geoms = list(geoms)
    solid = [i for i in geoms if not is_plane(model, i)]
    colliding = [i for i in solid if collides(model, i)]
    others = [i for i in solid if i not in colliding]
    shown = [i for i in others if is_seen(model, i)]
    shown_colliding = [i for i in colliding if is_seen(model, i)]
    stand_ins = _covered(model, data, shown_colliding, shown)
    surface = [i for i in solid if i in shown or (i in shown_colliding and i not in stand_ins)]
    told = {
        "left out, as planes have no inside": [i for i in geoms if i not in solid],
        "left out, as they are not seen and do not collide": [i for i in others if i not in shown],
        "taken for collision alone, as what is seen covers them": stand_ins,
        "taken for the surface, as nothing else is there to be seen": [] if surface else colliding,
    }
    notes = tuple(f"{reason}: {_names(model, which)}" for reason, which in told.items() if which)
    return Roles(tuple(surface or colliding), tuple(colliding), notes)


def is_seen(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo draws a geom if nobody asks for other groups."""
    return int(model.geom_group[geom]) < _NUM_SEEN_GROUPS and geom_rgba(model, geom)[3] > 0


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom can touch another, by its bits or because a pair names it."""
    is_paired = bool((model.pair_geom1 == geom).any() or (model.pair_geom2 == geom).any())
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) or is_paired


def _covered(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], shown: Sequence[int]
) -> list[int]:
    """Those of `geoms` that stand in for what is shown: it fills a third of them, and reaches as far.

    A sticker fills nothing of its carton, and what a glass holds ends below its rim.
    """
    if not (geoms and shown):
        return []
    others = [_convex(model, data, i) for i in shown]
    lower, upper = joined(others).bounds
    reach = _BEYOND * float(np.linalg.norm(upper - lower))
    covered = []
    for geom in geoms:
        mesh = _convex(model, data, geom)
        ends = (mesh.bounds[0] > lower - reach) & (mesh.bounds[1] < upper + reach)
        if (
            ends.all()
            and is_within_parts(_inner_points(mesh), [each.vertices for each in others]).mean() >= _FILLED
        ):
            covered.append(geom)
    return covered


def _convex(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Mesh:
    """A geom's hull; what is flat is given a thickness."""
    return Mesh.points(sound_points(geom_mesh(model, data, geom, 16).vertices)).hull()


def _inner_points(hull: Mesh) -> np.ndarray:
    """f64[256, 3]: points spread through a convex body."""
    center = hull.vertices.mean(0)
    depth = np.random.default_rng(0).uniform(size=(_NUM_POINTS, 1)) ** (1 / 3)
    return center + depth * (sample_surface(hull, _NUM_POINTS, 0) - center)


def _names(model: mujoco.MjModel, geoms: Sequence[int]) -> str:
    """The first few geoms by their names, or else by their kinds."""
    told = [repr(model.geom(i).name) if model.geom(i).name else _kind(model, i) for i in geoms[:_MOST_NAMES]]
    more = [f"{len(geoms) - _MOST_NAMES} more"] if len(geoms) > _MOST_NAMES else []
    return ", ".join([*told, *more])


def _kind(model: mujoco.MjModel, geom: int) -> str:
    return f"a {geom_kind(model, geom).name.removeprefix('mjGEOM_').lower()}"
