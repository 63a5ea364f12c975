"""Collisions of pure-JAX MJX by one function for all pairs of convex parts.

MJX compiles a function of its own for every pair of distinct meshes: seconds each, and ten objects have
hundreds of pairs. Here all parts are filled up to one size (corners, faces and edges that stand there twice
change nothing), so that one function, MJX's own, serves every pair, in blocks. Of many pairs only the nearest
are looked at, by their boxes; a scene in which more are near is told by `ConvexPairs.has_overflowed`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from mujoco import mjx
from mujoco.mjx._src import collision_convex, collision_driver, math, mesh
from mujoco.mjx._src.collision_types import ConvexInfo, GeomInfo

from cluttergen_jax.types import Array

_FIRMEST = (0.9, 0.95)
_SAME_NORMAL = 0.99
_lock = threading.RLock()


def soften_contacts(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy for MJX in pure JAX.

    Its Newton solver, in float32, throws a box on the table upwards at 7 m/s in one drop of ten if contacts
    are firmer; softer by a few micrometres they are solved.
    """
    model = model.__copy__()
    model.geom_solimp[:, :2] = np.minimum(model.geom_solimp[:, :2], _FIRMEST)
    return model


@contextmanager
def faces_first() -> Iterator[None]:
    """Inside, a face of MJX's meshes that touches flat keeps all four points.

    MJX compares the best face and the best pair of edges of two convex meshes and takes the edges wherever
    they are as deep to within a micrometre. Where two faces touch flat they always are, so rounding decides:
    a box at rest on a table lost three of its four contacts about every fifteenth step and never came to rest
    by the rule. Its box-box function prefers the face if both normals agree, and here the same is done.
    """
    with _lock:
        original = collision_convex._sat_gaussmap
        collision_convex._sat_gaussmap = _preferring_faces(original)
        try:
            yield
        finally:
            collision_convex._sat_gaussmap = original


def _preferring_faces(original: Callable[..., Any]) -> Callable[..., tuple[Array, Array, Array]]:
    def test(*args: Array) -> tuple[Array, Array, Array]:
        shape = args[:-4]
        (edges_a, *rest) = args[-4:]
        # Edges without length are never taken: what the faces alone say. Both in one go compile as one.
        both = jnp.stack([edges_a, jnp.repeat(edges_a[:, :1], 2, axis=1)])
        found = jax.vmap(lambda edges: original(*shape, edges, *rest))(both)
        normal = found[2][:, 0]
        is_flat = jnp.abs(normal[0] @ normal[1]) > _SAME_NORMAL
        dist, pos, normal = (jnp.where(is_flat, each[1], each[0]) for each in found)
        return dist, pos, normal

    return test


_POINTS = 4
"""Contacts that MJX's function gives of a pair."""
_BLOCK = 8
"""Pairs side by side; more are no faster, and take memory."""
# For each object: pairs that are looked at, and contacts that are kept, the deepest.
_NEAR_PAIRS = 24
_CONTACTS = 48


class _Shapes(struct.PyTreeNode):
    """All convex parts, filled up to one size, each in its own frame.

    Attributes:
      vert: f32[S, V, 3]; face: f32[S, F, W, 3], corners; face_normal: f32[S, F, 3].
      edge: i32[S, E, 2], corners' indices; edge_face_normal: f32[S, E, 2, 3].
    """

    vert: Array
    face: Array
    face_normal: Array
    edge: Array
    edge_face_normal: Array


class ConvexPairs:
    """The pairs of parts of a model that may touch, and how their contacts are found.

    Args:
      model: of boxes and meshes, all of the same contact parameters but for friction, and condim.
      mjx_model: the same on the device.
      num_objects: that move.
    """

    def __init__(self, model: mujoco.MjModel, mjx_model: mjx.Model, num_objects: int) -> None:
        shapes = [_shape(model, mjx_model, geom) for geom in range(model.ngeom)]
        self._shapes = _with_one_size(shapes)
        found = [(one, two) for one, two, _ in collision_driver.geom_pairs(model)]
        # MJX takes the one with fewer corners first.
        sizes = [len(shape.vert) for shape in shapes]
        self._geom = np.array(
            [sorted(pair, key=lambda geom: sizes[geom]) for pair in found]
        ).reshape(-1, 2)
        self._condim = int(model.geom_condim.max(initial=1))
        self._num_near = min(len(found), _NEAR_PAIRS * num_objects)
        self._num_contacts = min(_POINTS * self._num_near, _CONTACTS * num_objects)

    @contextmanager
    def replacing_mjx(self) -> Iterator[None]:
        """While MJX's data is made or a step is traced, this stands in place of MJX's collisions."""
        with faces_first():
            before = collision_driver.collision, collision_driver.make_condim
            collision_driver.collision = self.find_contacts
            collision_driver.make_condim = self._condims
            try:
                yield
            finally:
                collision_driver.collision, collision_driver.make_condim = before

    def _condims(self, *_: object, **__: object) -> np.ndarray:
        return np.full(self._num_contacts, self._condim)

    def has_overflowed(self, model: mjx.Model, data: mjx.Data) -> Array:
        """bool: more pairs were near than are looked at, or there are more contacts than are kept."""
        if not len(self._geom):
            return jnp.asarray(False)
        is_near = self._gaps(model, data) < 0
        return (jnp.sum(is_near) > self._num_near) | (
            self._num_contacts < _POINTS * self._num_near
        ) & jnp.all(data._impl.contact.dist < 0)

    def find_contacts(self, model: mjx.Model, data: mjx.Data) -> mjx.Data:
        """The data of one scene with its contacts, as `mjx.collision` gives it."""
        if not len(self._geom):
            return data
        geom = jnp.asarray(self._geom)
        if self._num_near < len(self._geom):
            geom = geom[jax.lax.top_k(-self._gaps(model, data), self._num_near)[1]]

        def touch(pair: Array) -> tuple[Array, Array, Array]:
            one, two = (self._convex_at(model, data, part) for part in pair)
            return collision_convex._convex_convex(one, two)

        dist, pos, normal = jax.lax.map(touch, geom, batch_size=_BLOCK)
        dist = dist.ravel()
        geom = jnp.repeat(geom, _POINTS, axis=0)
        pos = pos.reshape(-1, 3)
        normal = normal.reshape(-1, 3)
        if self._num_contacts < len(dist):
            deepest = jax.lax.top_k(-dist, self._num_contacts)[1]
            dist, pos, normal, geom = (each[deepest] for each in (dist, pos, normal, geom))
        one, two = geom.T
        priority = jnp.asarray(model.geom_priority)
        # What has the higher priority decides alone; of equals the rougher.
        decides = jnp.where(priority[two] > priority[one], two, one)
        friction = jnp.where(
            (priority[one] == priority[two])[:, None],
            jnp.maximum(model.geom_friction[one], model.geom_friction[two]),
            model.geom_friction[decides],
        )
        contact = data._impl.contact.replace(
            dist=dist,
            pos=pos,
            frame=jax.vmap(math.make_frame)(normal),
            includemargin=jnp.zeros_like(dist),
            friction=friction[:, [0, 0, 1, 2, 2]],
            solref=model.geom_solref[decides],
            solreffriction=jnp.zeros((len(dist), mujoco.mjNREF)),
            solimp=model.geom_solimp[decides],
            geom1=one,
            geom2=two,
            geom=geom,
        )
        return data.tree_replace({"_impl.contact": contact})

    def _convex_at(self, model: mjx.Model, data: mjx.Data, geom: Array) -> ConvexInfo:
        shape = jax.tree.map(lambda array: jnp.asarray(array)[geom], self._shapes)
        return ConvexInfo(
            data.geom_xpos[geom], data.geom_xmat[geom], model.geom_size[geom], **vars(shape)
        )

    def _gaps(self, model: mjx.Model, data: mjx.Data) -> Array:
        """f32[P], metres: at most the distance of each pair, from one's box to the other's ball."""
        center = model.geom_aabb[:, :3]
        half = model.geom_aabb[:, 3:]
        middle = data.geom_xpos + jnp.einsum("gij,gj->gi", data.geom_xmat, center)
        radius = jnp.linalg.norm(half, axis=-1)

        def gap(box: np.ndarray, ball: np.ndarray) -> Array:
            away = jnp.einsum("pji,pj->pi", data.geom_xmat[box], middle[ball] - middle[box])
            return (
                jnp.linalg.norm(jnp.maximum(jnp.abs(away) - half[box], 0.0), axis=-1) - radius[ball]
            )

        one, two = self._geom.T
        return jnp.maximum(gap(one, two), gap(two, one))


def _shape(model: mujoco.MjModel, mjx_model: mjx.Model, geom: int) -> _Shapes:
    """One geom's, not filled up, without an axis of shapes."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        found = mjx_model._impl.mesh_convex[model.geom_dataid[geom]]
    else:
        box = mesh.box(
            GeomInfo(jnp.zeros((1, 3)), jnp.eye(3)[None], jnp.asarray(model.geom_size[geom])[None])
        )
        found = box.replace(vert=box.vert[0], face=box.face[0])
    return _Shapes(*(np.asarray(getattr(found, field.name)) for field in fields(_Shapes)))


def _with_one_size(shapes: list[_Shapes]) -> _Shapes:
    """All shapes as one, with first rows once more where others have more."""

    def stack(*arrays: np.ndarray) -> np.ndarray:
        rows = max(len(array) for array in arrays)
        return np.stack(
            [np.concatenate([a, np.repeat(a[:1], rows - len(a), axis=0)]) for a in arrays]
        )

    width = max(shape.face.shape[1] for shape in shapes)
    even = [
        shape.replace(
            face=np.pad(shape.face, ((0, 0), (0, width - shape.face.shape[1]), (0, 0)), "edge")
        )
        for shape in shapes
    ]
    return jax.tree.map(stack, *even)
