"""MJCF geoms as meshes in the world frame, with the colours that MuJoCo gives them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.assets.cloud import sample_surface
from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh, join_meshes
from cluttergen_jax.assets.parts import sound_points
from cluttergen_jax.assets.quality.deviation import is_within_parts
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import primitives
from cluttergen_jax.importing.readers.mjcf_pictures import (
    flat_colour,
    geom_kind,
    picture_id,
    with_picture,
)

_GEOM = mujoco.mjtGeom
_FARTHEST = 1e6
"""Metres; beyond, the arithmetic of hulls breaks down."""
# What MuJoCo takes for "no colour given": a material's colour holds then.
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)


def is_plane(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is a plane: of the kinds that a file can hold, the one without an inside."""
    return geom_kind(model, geom) == _GEOM.mjGEOM_PLANE


def is_convex(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo collides a geom as a convex body: a mesh counts as its hull."""
    return geom_kind(model, geom) not in (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_HFIELD, _GEOM.mjGEOM_SDF)


def geom_rgba(model: mujoco.MjModel, geom: int) -> tuple[float, float, float, float]:
    """The colour that MuJoCo draws a geom in: its own if it has one, else its material's."""
    material = int(model.geom_matid[geom])
    own = model.geom_rgba[geom]
    is_given = material < 0 or not np.array_equal(own, _DEFAULT_RGBA)
    r, g, b, a = own if is_given else model.mat_rgba[material]
    return (float(r), float(g), float(b), float(a))


def geom_piece(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, max_side: int = MAX_TEXTURE
) -> Piece:
    """The geom's surface in the world frame, with its colour, and its picture as MuJoCo lays it on.

    What is asked for although its alpha is 0, because nothing else is seen, is drawn opaque.
    """
    r, g, b, alpha = geom_rgba(model, geom)
    colour = (r, g, b, alpha or 1.0)
    picture = picture_id(model, geom)
    if picture < 0:
        return Piece(geom_mesh(model, data, geom), colour)
    if (flat := flat_colour(model, picture)) is not None:
        r, g, b = (flat * colour[:3]).tolist()
        return Piece(geom_mesh(model, data, geom), (r, g, b, colour[3]))
    if (found := with_picture(model, geom, _own_mesh(model, geom), picture, max_side)) is None:
        return Piece(geom_mesh(model, data, geom), colour)
    mesh, uv, texture = found
    return Piece(_place(model, data, geom, mesh), colour, uv, texture)


def geom_mesh(model: mujoco.MjModel, data: mujoco.MjData, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in the world frame of the reference configuration.

    Raises:
      AssetError: it is a plane, or out of all bounds.
    """
    return _place(model, data, geom, _own_mesh(model, geom, sections))


def _own_mesh(model: mujoco.MjModel, geom: int, sections: int = 32) -> Mesh:
    """The geom's surface in its own frame."""
    size = model.geom_size[geom]
    data_id = int(model.geom_dataid[geom])
    kind = geom_kind(model, geom)
    if kind in (_GEOM.mjGEOM_MESH, _GEOM.mjGEOM_SDF):
        # Of an SDF, MuJoCo makes a mesh when it compiles the file.
        return _mesh_asset(model, data_id)
    if kind == _GEOM.mjGEOM_HFIELD:
        return _height_field(model, data_id)
    if kind == _GEOM.mjGEOM_BOX:
        return primitives.box(size)
    if kind == _GEOM.mjGEOM_CYLINDER:
        return primitives.cylinder(size[0], size[1], sections)
    if kind == _GEOM.mjGEOM_CAPSULE:
        return primitives.capsule(size[0], size[1])
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        return primitives.ellipsoid(size)
    if kind == _GEOM.mjGEOM_SPHERE:
        return primitives.ellipsoid(np.full(3, size[0]))
    raise AssetError(f"a geom of type {kind.name}", "geoms with an inside: all kinds but planes")


def _place(model: mujoco.MjModel, data: mujoco.MjData, geom: int, mesh: Mesh) -> Mesh:
    """A mesh in the geom's frame, in the world frame; AssetError where that is out of all bounds."""
    mesh = mesh.transform(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
    # A number that is NaN compares as no.
    if not (np.abs(mesh.vertices) <= _FARTHEST).all():
        name = model.geom(geom).name or f"number {geom}"
        raise AssetError(
            f"geom {name!r} reaches beyond {_FARTHEST:,.0f} m, or is nowhere", "sizes in metres"
        )
    return mesh


def _mesh_asset(model: mujoco.MjModel, mesh: int) -> Mesh:
    first = model.mesh_vertadr[mesh]
    count = model.mesh_vertnum[mesh]
    first_face = model.mesh_faceadr[mesh]
    face_count = model.mesh_facenum[mesh]
    faces = model.mesh_face[first_face : first_face + face_count]
    return Mesh(model.mesh_vert[first : first + count], faces)


def _height_field(model: mujoco.MjModel, field: int) -> Mesh:
    rows = int(model.hfield_nrow[field])
    columns = int(model.hfield_ncol[field])
    start = int(model.hfield_adr[field])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    half_x, half_y, highest, base = (float(each) for each in model.hfield_size[field])
    return primitives.height_field(heights * highest, half_x, half_y, base)


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
      unseen: the geoms that neither are seen nor collide.
    """

    surface: tuple[int, ...]
    colliding: tuple[int, ...]
    notes: tuple[str, ...] = ()
    unseen: tuple[int, ...] = ()


def roles_of(model: mujoco.MjModel, data: mujoco.MjData, geoms: Iterable[int]) -> Roles:
    """The roles of one body's geoms, as they stand in `data`; planes have none."""
    geoms = list(geoms)
    solid = [i for i in geoms if not is_plane(model, i)]
    colliding = [i for i in solid if collides(model, i)]
    others = [i for i in solid if i not in colliding]
    shown = [i for i in others if is_visible(model, i)]
    shown_colliding = [i for i in colliding if is_visible(model, i)]
    stand_ins = _find_stand_ins(model, data, shown_colliding, shown)
    surface = [i for i in solid if i in shown or (i in shown_colliding and i not in stand_ins)]
    unseen = tuple(i for i in others if i not in shown)
    reasons = {
        "left out, as planes have no inside": [i for i in geoms if i not in solid],
        "left out, as they are not seen and do not collide": unseen,
        "taken for collision alone, as what is seen covers them": stand_ins,
        "taken for the surface, as nothing else is there to be seen": [] if surface else colliding,
    }
    notes = tuple(f"{reason}: {_names(model, which)}" for reason, which in reasons.items() if which)
    return Roles(tuple(surface or colliding), tuple(colliding), notes, unseen)


def is_visible(model: mujoco.MjModel, geom: int) -> bool:
    """Whether MuJoCo draws a geom if nobody asks for other groups."""
    return int(model.geom_group[geom]) < _NUM_SEEN_GROUPS and geom_rgba(model, geom)[3] > 0


def collides(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom can touch another, by its bits or because a pair names it."""
    is_paired = bool((model.pair_geom1 == geom).any() or (model.pair_geom2 == geom).any())
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) or is_paired


def _find_stand_ins(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], shown: Sequence[int]
) -> list[int]:
    """Those of `geoms` that stand in for what is shown: it fills a third of them, and reaches as far.

    A sticker fills nothing of its carton, and what a glass holds ends below its rim.
    """
    if not (geoms and shown):
        return []
    others = [_convex(model, data, i) for i in shown]
    lower, upper = join_meshes(others).bounds
    reach = _BEYOND * float(np.linalg.norm(upper - lower))
    covered = []
    for geom in geoms:
        mesh = _convex(model, data, geom)
        ends = (mesh.bounds[0] > lower - reach) & (mesh.bounds[1] < upper + reach)
        if (
            ends.all()
            and is_within_parts(_inner_points(mesh), [each.vertices for each in others]).mean()
            >= _FILLED
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
    kinds = {i: geom_kind(model, i).name.removeprefix("mjGEOM_").lower() for i in geoms}
    names = [
        repr(model.geom(i).name) if model.geom(i).name else f"a {kinds[i]}"
        for i in geoms[:_MOST_NAMES]
    ]
    more = [f"{len(geoms) - _MOST_NAMES} more"] if len(geoms) > _MOST_NAMES else []
    return ", ".join([*names, *more])
