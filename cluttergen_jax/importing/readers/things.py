"""Several things in one mesh file: which pieces belong together, what each is called, a sheet below them.

Pieces whose boxes overlap, or are apart by little against the larger one's size, are one thing, as a mug and
its lid are. Pieces with names of their own that are farther apart are several; those without only where they
are farther apart than the larger one is long. A flat sheet beside all else, and much larger, is scenery.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mesh import Mesh, component_labels
from cluttergen_jax.assets.shape import Piece
from cluttergen_jax.errors import AssetError, ConfigError, closest, first_names
from cluttergen_jax.importing.readers.mesh_file import (
    MeshFile,
    as_utf8,
    read_mesh_file,
)
from cluttergen_jax.importing.readers.source import says_something

_NEAR = 0.15
"""Of the larger one's longest side: pieces whose boxes are no farther apart are one thing."""
_FAR = 0.9
"""The same, of pieces that have no names of their own: those of "part_1" and "part_2" are none."""
# Of the largest thing's longest side: smaller ones are crumbs of others; those with a name of their own.
_LEAST = 0.2
_LEAST_NAMED = 0.02

_MAX_PIECES = 1500
"""The largest so many are looked at."""
# A sheet's thickness over its shorter side, at most; its area over that of the rest from above, at least.
_THIN = 0.02
_MUCH_LARGER = 4.0

_MAX_NAMED = 20


class SeveralThings(AssetError):
    """A mesh file holds several things that do not touch.

    Attributes:
      places: each as it is chosen, `file.glb#name`.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self.places = tuple(f"{path.name}#{name}" for name in names)
        super().__init__(
            f"{path} holds {len(names)} things that do not touch",
            "one of them, by its name or number behind '#'",
            first_names(self.places, _MAX_NAMED, ""),
        )


def read_thing(
    path: Path, max_side: int = MAX_TEXTURE, node: str = "", is_whole: bool = True
) -> MeshFile:
    """`read_mesh_file`, of one thing in the file.

    Args:
      node: the node of a scene, with all below it, the `o` or `g` of an OBJ file, or the number of a thing
        that is taken; empty for the whole file.
      is_whole: whether a file is taken as it is; else it has to hold one thing, and scenery is left out.

    Raises:
      AssetError: see `read_mesh_file`; `SeveralThings`.
      ConfigError: the file has no such node.
    """
    file = read_mesh_file(path, max_side)
    # `read_shape` reports what is not finite.
    if (is_whole and not node) or not all(
        np.isfinite(each.mesh.vertices).all() for each in file.pieces
    ):
        return file
    scene = _Scene(path, file)
    if node:
        return MeshFile(scene.cut_out(scene.choose(node)), file.notes)
    sheet = scene.sheet
    if len(scene.things) > 1 and scene.is_of_several:
        raise SeveralThings(path, scene.names())
    notes = file.notes
    if len(scene.things) > 1:
        each = ", ".join(f"{path.name}#{name}" for name in scene.names()[:_MAX_NAMED])
        notes = (
            *notes,
            f"it is made of {len(scene.things)} pieces that do not touch; one alone: {each}",
        )
    if sheet is None:
        return MeshFile(file.pieces, notes)
    name = scene.own_name(sheet)
    called = f"the flat sheet {name!r}" if name else "a flat sheet"
    notes = (*notes, f"{called} beside it is scenery and is left out; `take_all` takes it")
    rest = [each for each in scene.components if each is not sheet]
    return MeshFile(scene.cut_out(rest), notes)


@dataclass(frozen=True, eq=False)
class _Component:
    """Connected triangles of one piece."""

    piece: int
    faces: np.ndarray  # i[F], their numbers.
    low: np.ndarray  # f64[3], the box around them.
    high: np.ndarray

    @property
    def size(self) -> float:
        return float((self.high - self.low).max())


class _Scene:
    """What a mesh file holds, in connected pieces."""

    def __init__(self, path: Path, file: MeshFile) -> None:
        self._path = path
        self._file = file
        self.components = [
            each
            for index, piece in enumerate(file.pieces)
            for each in _components(index, piece.mesh)
        ]
        self.sheet = _sheet(self.components)
        rest = [each for each in self.components if each is not self.sheet]
        self._of_obj: dict[tuple[float, ...], tuple[str, ...]] | None = None
        self.things = _things(rest, _NEAR, self._titles)

    @property
    def is_of_several(self) -> bool:
        """Whether the things are objects of their own, not one object in loose pieces."""
        own = self._titles(self.things)
        kinds = {re.sub(r"[-_. ]?\d+", "", name.lower()) for name in own}
        if len(kinds) == len(own) and all(map(says_something, kinds)):
            return True
        return (
            len(_things([each for thing in self.things for each in thing], _FAR, self._titles)) > 1
        )

    def names(self) -> list[str]:
        """What each thing is called: by its name where no other has it, else by its number."""
        own = self._titles(self.things)
        return [name if name and own.count(name) == 1 else str(i) for i, name in enumerate(own)]

    def own_name(self, component: _Component) -> str:
        """The innermost name that says something; else empty."""
        return next(filter(says_something, self._chain(component)), "")

    def _titles(self, groups: Sequence[Sequence[_Component]]) -> list[str]:
        return [self.own_name(max(each, key=lambda one: one.size)) for each in groups]

    def choose(self, node: str) -> list[_Component]:
        """The components that hang on a node, or are the thing of a number (ConfigError: there is none)."""
        found = [each for each in self.components if node in self._chain(each)]
        if not found and node.isdecimal() and int(node) < len(self.things):
            found = self.things[int(node)]
        if not found:
            names = self.names()
            known = dict.fromkeys(name for each in self.components for name in self._chain(each))
            allowed = list(dict.fromkeys([*names, *known]))
            raise ConfigError(
                f"{self._path.name}#{node}",
                first_names(allowed, _MAX_NAMED, ", ..."),
                meant=closest(node, allowed),
            )
        return found

    def cut_out(self, components: Sequence[_Component]) -> list[Piece]:
        """The pieces of the file without all other components."""
        pieces = []
        for index, piece in enumerate(self._file.pieces):
            own = [each.faces for each in components if each.piece == index]
            if own:
                faces = np.sort(np.concatenate(own))
                pieces.append(
                    piece if len(faces) == len(piece.mesh.faces) else _with_faces(piece, faces)
                )
        return pieces

    def _chain(self, component: _Component) -> tuple[str, ...]:
        """The names of what a component hangs on, the innermost first."""
        if self._path.suffix.lower() != ".obj":
            return self._file.names[component.piece]
        if self._of_obj is None:
            # What trimesh reads all the same bears no names.
            with suppress(ValueError, IndexError):
                self._of_obj = _obj_names(self._path)
            self._of_obj = self._of_obj or {}
        mesh = self._file.pieces[component.piece].mesh
        return self._of_obj.get(
            tuple(mesh.vertices[mesh.faces[component.faces[0], 0]].tolist()), ()
        )


def _components(index: int, mesh: Mesh) -> list[_Component]:
    """The connected pieces of a mesh, corners at one place being one."""
    points = np.ascontiguousarray(mesh.vertices + 0.0)
    _, welded = np.unique(points.view([("", points.dtype)] * 3).ravel(), return_inverse=True)
    corners = welded.reshape(-1)[mesh.faces]
    ends = np.concatenate([corners[:, :2], corners[:, 1:]])
    labels = component_labels(ends, len(points))[corners[:, 0]]
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
    around = mesh.vertices[mesh.faces]
    lows = np.minimum.reduceat(around.min(1)[order], starts)
    highs = np.maximum.reduceat(around.max(1)[order], starts)
    found = [
        _Component(index, faces, low, high)
        for faces, low, high in zip(np.split(order, starts[1:]), lows, highs, strict=True)
    ]
    return sorted(found, key=lambda each: int(each.faces[0]))


def _things(
    components: Sequence[_Component],
    near: float,
    titles: Callable[[list[list[_Component]]], list[str]],
) -> list[list[_Component]]:
    """Components that belong together; crumbs go to what they are nearest to.

    Args:
      titles: what groups are called.
    """
    if not components:
        return []
    large = sorted(components, key=lambda each: -each.size)[:_MAX_PIECES]
    chosen = set(map(id, large))
    kept = [each for each in components if id(each) in chosen]
    groups = [[each] for each in kept]
    while True:
        low, high = _boxes(groups)
        apart = _gaps(low, high, low, high) <= near * np.maximum.outer(*[(high - low).max(1)] * 2)
        count, label = connected_components(coo_matrix(apart), directed=False)
        if count == len(groups):
            break
        groups = [
            [one for k in np.flatnonzero(label == i) for one in groups[k]] for i in range(count)
        ]
    size = (high - low).max(1)
    is_thing = size >= _LEAST * size.max()
    if not is_thing.all():
        own = titles(groups)
        is_named = np.array([bool(name) and own.count(name) == 1 for name in own])
        is_thing |= is_named & (size >= _LEAST_NAMED * size.max())
    things = []
    crumbs = []
    for group, is_large in zip(groups, is_thing, strict=True):
        if is_large:
            things.append(group)
        else:
            crumbs += group
    crumbs += [each for each in components if id(each) not in chosen]
    if crumbs:
        nearest = _gaps(*_boxes([[each] for each in crumbs]), *_boxes(things)).argmin(1)
        for each, index in zip(crumbs, nearest, strict=True):
            things[index].append(each)
    return things


def _boxes(groups: Sequence[Sequence[_Component]]) -> tuple[np.ndarray, np.ndarray]:
    """f64[G, 3] each: the lower and the upper corners of the boxes around groups."""
    low = np.array([np.min([each.low for each in group], axis=0) for group in groups])
    high = np.array([np.max([each.high for each in group], axis=0) for group in groups])
    return low, high


def _gaps(
    low: np.ndarray, high: np.ndarray, other_low: np.ndarray, other_high: np.ndarray
) -> np.ndarray:
    """f64[A, B]: distances between boxes; 0 where they overlap."""
    apart = np.maximum(low[:, None] - other_high, other_low - high[:, None])
    return np.linalg.norm(np.maximum(apart, 0.0), axis=-1)


def _sheet(components: Sequence[_Component]) -> _Component | None:
    """The flat sheet that all else lies on one side of, much larger than that; None if there is none."""
    if len(components) < 2:
        return None
    sheet = max(components, key=lambda each: each.size)
    low, high = _boxes([[each for each in components if each is not sheet]])
    rest_low = low[0]
    rest_high = high[0]
    sides = sheet.high - sheet.low
    rest = rest_high - rest_low
    thin = int(sides.argmin())
    others = [axis for axis in range(3) if axis != thin]
    slack = _THIN * rest[thin]
    is_beside = (
        rest_low[thin] >= sheet.high[thin] - slack or rest_high[thin] <= sheet.low[thin] + slack
    )
    is_thin = sides[thin] <= _THIN * min(sides[others])
    has_depth = rest[thin] > max(sides[thin], _NEAR * max(rest[others]))
    is_around = (sheet.low <= rest_low)[others].all() and (sheet.high >= rest_high)[others].all()
    is_large = sides[others].prod() >= _MUCH_LARGER * rest[others].prod()
    return sheet if is_beside and is_thin and has_depth and is_around and is_large else None


def _with_faces(piece: Piece, faces: np.ndarray) -> Piece:
    """A piece of some of the triangles of another."""
    kept = piece.mesh.faces[faces]
    used, numbers = np.unique(kept, return_inverse=True)
    mesh = Mesh(piece.mesh.vertices[used], numbers.reshape(kept.shape))
    return replace(
        piece,
        mesh=mesh,
        uv=None if piece.uv is None else piece.uv[used],
        colours=None if piece.colours is None else piece.colours[used],
    )


def _obj_names(path: Path) -> dict[tuple[float, ...], tuple[str, ...]]:
    """By the place of a vertex, the group (`g`) and the object (`o`) of an OBJ file that have it."""
    places: list[tuple[float, ...]] = []
    found: dict[tuple[float, ...], tuple[str, ...]] = {}
    chain: dict[str, str] = {}
    for line in as_utf8(path.read_bytes()).decode(errors="replace").splitlines():
        word, *rest = line.split(None, 1) or ("",)
        text = "".join(rest).strip()
        if word == "v":
            places.append(tuple(float(each) + 0.0 for each in text.split()[:3]))
        elif word == "o":
            chain = {"o": text}
        elif word == "g":
            chain["g"] = text
        elif word == "f" and chain:
            names = tuple(chain[each] for each in ("g", "o") if chain.get(each))
            for corner in text.split():
                number = int(corner.split("/")[0])
                found.setdefault(places[number - 1 if number > 0 else number], names)
    return found
