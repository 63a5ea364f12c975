"""How much sense scenes make: what carries what, how things are turned and what is near them, by a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import islice
from types import SimpleNamespace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from cluttergen_jax.assets.sense import FREE, SceneSense, plan_shape
from cluttergen_jax.importing.readers.mjcf import Geom
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.margin import MAX_BESIDE
from cluttergen_jax.placement.world import World, base_name, compile_layout

if TYPE_CHECKING:
    from cluttergen_jax.scene.bank import Bank

GAP = 0.001
"""Metres between two bodies up to which they count as touching."""
NEAR = 0.10
"""Metres between circles around two things up to which they are near each other."""
EDGE_DEGREES = 5.0
"""By which a box-like thing's side may differ from an edge of what carries it."""
_MOST_SHOWN = 12
Pairs = tuple[tuple[str, str], ...]
"""Names: what is carried, and what carries it."""


@dataclass(frozen=True)
class SenseFindings:
    """What a table of sense says of a scene, or of several together.

    Attributes:
      usual, unusual: pairs of things, what is carried and what carries it, whose kinds are known.
      unknown: pairs of which one is free.
      num_boxes: box-like things; num_along: those with a side along an edge, to `EDGE_DEGREES`.
      num_paired: things with a usual neighbour in the scene; num_near: those with one that is near (`NEAR`).
      free: names of things without a kind.
    """

    usual: Pairs = ()
    unusual: Pairs = ()
    unknown: Pairs = ()
    num_boxes: int = 0
    num_along: int = 0
    num_paired: int = 0
    num_near: int = 0
    free: tuple[str, ...] = ()

    @staticmethod
    def total(each: Iterable[SenseFindings]) -> SenseFindings:
        """Those of several scenes."""
        found = list(each)
        return SenseFindings(
            usual=tuple(pair for one in found for pair in one.usual),
            unusual=tuple(pair for one in found for pair in one.unusual),
            unknown=tuple(pair for one in found for pair in one.unknown),
            num_boxes=sum(one.num_boxes for one in found),
            num_along=sum(one.num_along for one in found),
            num_paired=sum(one.num_paired for one in found),
            num_near=sum(one.num_near for one in found),
            free=tuple(name for one in found for name in one.free),
        )

    @property
    def usual_pairs(self) -> float | None:
        """The share of carried pairs of known kinds that are usual; None where there are none."""
        return _share(len(self.usual), len(self.usual) + len(self.unusual))

    @property
    def along_edges(self) -> float | None:
        """The share of box-like things with a side along an edge; None where there are none."""
        return _share(self.num_along, self.num_boxes)

    @property
    def near_neighbours(self) -> float | None:
        """The share of things with a usual neighbour in their scene that are near one; None likewise."""
        return _share(self.num_near, self.num_paired)

    def row_of(self, name: str) -> dict[str, str | bool | None]:
        """What carries a thing, and whether that is usual; None where it is not known or nothing does."""
        lists = {True: self.usual, False: self.unusual, None: self.unknown}
        found = [
            (lower, how) for how, pairs in lists.items() for upper, lower in pairs if upper == name
        ]
        known = [how for _, how in found if how is not None]
        return {
            "carried_by": ", ".join(sorted(lower for lower, _ in found)),
            "is_usual": all(known) if known else None,
        }

    def record(self) -> dict[str, float | int | None]:
        """JSON values."""
        return {
            "usual_pairs": self.usual_pairs,
            "num_pairs": len(self.usual) + len(self.unusual),
            "along_edges": self.along_edges,
            "near_neighbours": self.near_neighbours,
            "num_free": len({*self.free}),
        }

    def lines(self) -> list[str]:
        """For people."""
        number = len(self.usual) + len(self.unusual)
        lines = [
            f"usual pairs {_text(self.usual_pairs)} of {number} in which one thing carries another",
            f"along edges {_text(self.along_edges)} of {self.num_boxes} box-like things, to "
            f"{EDGE_DEGREES:g} deg",
            f"in groups   {_text(self.near_neighbours)} of {self.num_paired} things are within "
            f"{100 * NEAR:g} cm of a usual neighbour",
        ]
        if self.unusual:
            lines.append(
                f"unusual     {_list_most(f'{upper} on {lower}' for upper, lower in self.unusual)}"
            )
        if self.free:
            more = f"; {len(self.unknown)} carried pairs are not counted" if self.unknown else ""
            lines.append(f"free        without a known label: {_list_most(self.free)}{more}")
        return lines


def _share(number: int, total: int) -> float | None:
    return number / total if total else None


def _text(share: float | None) -> str:
    return "none" if share is None else f"{share:.3f}"


def _list_most(names: Iterable[str]) -> str:
    counts = Counter(names).most_common()
    shown = [f"{name} ({number})" if number > 1 else name for name, number in counts[:_MOST_SHOWN]]
    more = f" and {len(counts) - _MOST_SHOWN} more" if len(counts) > _MOST_SHOWN else ""
    return ", ".join(shown) + more


def find_sense(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    bodies: Sequence[int],
    names: Sequence[str],
    is_shape: np.ndarray,
    sense: SceneSense,
    kinds: Sequence[str] | None = None,
    gap: float = GAP,
) -> SenseFindings:
    """What a table says of a scene at its start.

    Args:
      model, data: at the start, positions and contacts of bodies up to `gap` apart computed; read alone.
      bodies: the ids of the things; names: of each.
      is_shape: bool[ngeom], the geoms that are their shapes.
      kinds: of each thing; by its name if not given.
      gap: metres between two things up to which they touch.
    """
    kinds = [kind_of_name(name, sense) for name in names] if kinds is None else list(kinds)
    number = len(kinds)
    owner = _owners(model, bodies)
    usual, unusual, unknown = _judged_pairs(model, data, owner, names, kinds, sense, gap)
    points = [
        _points(model, data, np.flatnonzero((owner == one) & is_shape)) for one in range(number)
    ]
    shapes = [plan_shape(each) for each in points]
    edges = _edges(model, data, owner, gap)
    # What lies on other things is seen against the table that some of them lie on.
    of_scene = next(iter(edges.values()), 0.0)
    boxes = [one for one, shape in enumerate(shapes) if shape.is_box_like]
    turns = np.array([shapes[one].heading - edges.get(one, of_scene) for one in boxes])
    off = np.abs((turns + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    beside = [
        [one != two and _are_neighbours(kinds[one], kinds[two], sense) for two in range(number)]
        for one in range(number)
    ]
    is_beside = np.array(beside, bool).reshape(number, number)
    centers = np.array([each[:, :2].mean(0) for each in points]).reshape(-1, 2)
    radii = np.array([sum(shape.sides) / 4 for shape in shapes])
    distance = np.linalg.norm(centers[:, None] - centers, axis=-1) - radii[:, None] - radii
    return SenseFindings(
        usual=usual,
        unusual=unusual,
        unknown=unknown,
        num_boxes=len(boxes),
        num_along=int((off <= np.radians(EDGE_DEGREES)).sum()),
        num_paired=int(is_beside.any(1).sum()),
        num_near=int((is_beside & (distance <= NEAR)).any(1).sum()),
        free=tuple(name for name, kind in zip(names, kinds, strict=True) if kind == FREE),
    )


def sense_of_bank(bank: Bank, sense: SceneSense, most: int = 1000) -> SenseFindings:
    """What a table says of the scenes of a bank that stand, of `most` at most, the first ones."""
    rows = islice((row for row in bank.scenes() if row.is_success), most)
    asset_of = cache(lambda name: bank.object(base_name(name)))

    @lru_cache(maxsize=8)
    def layout_of(names: tuple[str, ...]) -> Layout:
        objects = [asset_of(name) for name in names]
        return compile_layout(names, objects, bank.support, bank.stability, bank.contact)

    found = []
    for row in rows:
        order = np.argsort(row.objects)
        names = tuple(row.objects[place] for place in order)
        layout = layout_of(names)
        kinds = [sense.kind_of(asset_of(name)) for name in names]
        data = _standing(layout, np.arange(len(names)), row.poses[order])
        # Objects collide by their parts, and are drawn by other geoms.
        is_shape = layout.model.geom_contype != 0
        bodies = layout.body_index.tolist()
        found.append(find_sense(layout.model, data, bodies, names, is_shape, sense, kinds))
    return SenseFindings.total(found)


def find_usual_pairs(
    world: World,
    object_index: np.ndarray,
    is_placed: np.ndarray,
    poses: np.ndarray,
    sense: SceneSense,
) -> SenseFindings:
    """Who carries whom in N scenes of S slots of a world, and whether that is usual; nothing else.

    Args:
      object_index: i[N, S]; is_placed: bool[N, S]; poses: f[N, S, 7], world, metres, wxyz.
    """
    layout = world.layout
    kinds = [sense.kind_of(asset) for asset in world.objects]
    owner = _owners(layout.model, layout.body_index.tolist())
    found = []
    for index, placed, of_slots in zip(object_index, is_placed, poses, strict=True):
        data = _standing(layout, index[placed], of_slots[placed])
        usual, unusual, unknown = _judged_pairs(
            layout.model, data, owner, world.names, kinds, sense, GAP
        )
        found.append(SenseFindings(usual, unusual, unknown))
    return SenseFindings.total(found)


def _standing(layout: Layout, objects: np.ndarray, poses: np.ndarray) -> mujoco.MjData:
    """Some of a layout's objects at poses f[n, 7], the others parked; with contacts up to `GAP` apart."""
    model = copy(layout.model)
    model.geom_margin[:] = np.maximum(model.geom_margin, GAP)
    data = mujoco.MjData(model)
    qpos = layout.parked
    qpos[objects] = poses
    data.qpos[:] = qpos.ravel()
    mujoco.mj_fwdPosition(model, data)
    return data


def _owners(model: mujoco.MjModel, bodies: Sequence[int]) -> np.ndarray:
    """i[ngeom]: the place among bodies of the one that a geom belongs to, -1 for none."""
    place = np.full(model.nbody, -1)
    place[list(bodies)] = np.arange(len(bodies))
    return place[model.body_rootid[model.geom_bodyid]]


def _judged_pairs(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    owner: np.ndarray,
    names: Sequence[str],
    kinds: Sequence[str],
    sense: SceneSense,
    gap: float,
) -> tuple[Pairs, Pairs, Pairs]:
    """The pairs of a scene that are usual, that are not, and those of which one is free."""
    pairs: list[list[tuple[str, str]]] = [[], [], []]
    for upper, lower in sorted(_carried_pairs(model, data, owner, gap)):
        is_free = FREE in (kinds[upper], kinds[lower])
        is_usual = any(sense.is_usual(how, kinds[lower], kinds[upper]) for how in ("on", "in"))
        pairs[2 if is_free else 0 if is_usual else 1].append((names[upper], names[lower]))
    usual, unusual, unknown = map(tuple, pairs)
    return usual, unusual, unknown


def kind_of_name(name: str, sense: SceneSense) -> str:
    """The kind of a thing of which only the name of its body is known."""
    return sense.kind_of(SimpleNamespace(name=name, label="", synset=""))


def _are_neighbours(one: str, two: str, sense: SceneSense) -> bool:
    return sense.is_usual("beside", one, two) or sense.is_usual("beside", two, one)


def _carried_pairs(
    model: mujoco.MjModel, data: mujoco.MjData, owner: np.ndarray, gap: float
) -> set[tuple[int, int]]:
    """Which thing is pressed upwards by which other, by their places."""
    found = set()
    for contact, lift in _contacts(model, data, gap):
        first, second = (owner[contact.geom[0]], owner[contact.geom[1]])
        if first >= 0 and second >= 0 and first != second and abs(lift) >= MAX_BESIDE:
            found.add((second, first) if lift > 0 else (first, second))
    return {(int(upper), int(lower)) for upper, lower in found}


def _edges(
    model: mujoco.MjModel, data: mujoco.MjData, owner: np.ndarray, gap: float
) -> dict[int, float]:
    """Radians: how the boxes are turned that carry things and are none themselves, by the things' places."""
    found = {}
    for contact, _ in _contacts(model, data, gap):
        for own, other in ((0, 1), (1, 0)):
            thing, ground = (owner[contact.geom[own]], contact.geom[other])
            if thing >= 0 > owner[ground] and model.geom_type[ground] == mujoco.mjtGeom.mjGEOM_BOX:
                x_axis = data.geom_xmat[ground].reshape(3, 3)[:2, 0]
                found[int(thing)] = float(np.arctan2(x_axis[1], x_axis[0]))
    return found


def _contacts(
    model: mujoco.MjModel, data: mujoco.MjData, gap: float
) -> Iterable[tuple[mujoco.MjContact, float]]:
    """Contacts of geoms up to a gap apart, and the sine with which the first presses the second upwards."""
    down = model.opt.gravity / max(float(np.linalg.norm(model.opt.gravity)), 1e-9)
    for contact in data.contact[: data.ncon]:
        if contact.dist <= gap and min(contact.geom) >= 0:
            yield contact, float(-contact.frame[:3] @ down)


def _points(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """f64[P, 3]: vertices of some geoms, world, metres."""
    meshes = [Geom(model, data, int(geom)).mesh() for geom in geoms]
    return np.concatenate([each.vertices for each in meshes] or [np.zeros((1, 3))])
