"""A support: the fixed thing that carries the objects, its collision made of boxes and convex parts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Joint, Piece, Provenance
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.geometry import (
    at_height,
    box_corners,
    rectangle_corners,
    rotate_in_plane,
    rotation_matrix,
    transform_points,
    yaw_matrix,
)

Ring = tuple[tuple[float, float], ...]
"""A polygon's corners, one after the other: counter-clockwise around it, clockwise around a hole."""

_NARROW = 0.01
"""Half the width of gaps, as between planks, that are no edge."""

_SMALLEST_AREA = 4e-4
PART_RGBA = (0.72, 0.55, 0.38, 1.0)
"""The colour of collision that is drawn for want of visual pieces."""

LEVEL = 0.002
"""Metres by which boxes of one top may differ in height."""


@dataclass(frozen=True)
class Box:
    """A solid box in the world frame.

    Attributes:
      center: metres.
      half_extents: metres.
      yaw: radians about z.
      rgba: its colour where the support has no visual pieces.
    """

    center: tuple[float, float, float]
    half_extents: tuple[float, float, float]
    yaw: float = 0.0
    rgba: tuple[float, float, float, float] = PART_RGBA

    @property
    def outline(self) -> np.ndarray:
        """f64[4, 2], metres, world x and y, counter-clockwise."""
        return rectangle_corners(self.center[:2], self.half_extents[:2], self.yaw)

    @property
    def top(self) -> float:
        """Metres: the height of its upper face."""
        return self.center[2] + self.half_extents[2]

    @property
    def mesh(self) -> Mesh:
        """Its triangles, world frame."""
        local = _BOX_CORNERS * self.half_extents
        return Mesh(local @ yaw_matrix(self.yaw).T + np.array(self.center), _BOX_FACES)


_BOX_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_BOX_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_BOX_FACES = np.array([face for a, b, c, d in _BOX_QUADS for face in ((a, b, c), (a, c, d))])


@dataclass(frozen=True)
class Rectangle:
    """A queried region as it lies on a support's top; finite, its sides above zero.

    Attributes:
      center: metres, world x and y.
      half_extents: metres, along its own x and y.
      yaw: radians, from world x to its own x.
    """

    center: tuple[float, float] = (0.0, 0.0)
    half_extents: tuple[float, float] = (0.3, 0.35)
    yaw: float = 0.0

    def __post_init__(self) -> None:
        numbers = (*self.center, *self.half_extents, self.yaw)
        if not all(map(math.isfinite, numbers)) or min(self.half_extents) <= 0:
            x, y = self.half_extents
            raise ConfigError(
                f"a rectangle of {2 * x:g} x {2 * y:g} m about {tuple(self.center)}, turned by {self.yaw:g}",
                "finite numbers, sides above zero",
                "metres, such as 0.4x0.5",
            )

    @property
    def corners(self) -> np.ndarray:
        """f64[4, 2], metres, world x and y, counter-clockwise."""
        return rectangle_corners(self.center, self.half_extents, self.yaw)

    def covers(self, points: np.ndarray) -> np.ndarray:
        """bool[...]: whether points, f64[..., 2], lie in it or on its edge."""
        local = rotate_in_plane(points - np.array(self.center), -self.yaw)
        return (np.abs(local) <= self.half_extents).all(-1)

    def spread(self, shares: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """f64[N, 2]: the points at shares f64[N, 2] of its half extents, which may be larger by a margin."""
        local = shares * (np.array(self.half_extents) + margin)
        return rotate_in_plane(local, self.yaw) + self.center


@dataclass(frozen=True)
class Surface:
    """A face of a support that carries objects: level, or tilted by up to 10 degrees.

    Its frame has z along the face's normal. That of a level one is the world's, lifted to its height.

    Attributes:
      name: unique among a support's surfaces.
      position: its frame's origin, world, metres.
      region: the region queried by default: the largest good rectangle on it, in its frame.
      outline: its outer edge in its frame, metres, counter-clockwise.
      holes: the edges of what is cut out of it or stands on it, clockwise.
      quaternion: of its frame, wxyz.
      free_height: metres along its z from its region up to the lowest thing that hangs over it; inf under the
        open sky.
    """

    name: str
    position: tuple[float, float, float]
    region: Rectangle
    outline: Ring
    holes: tuple[Ring, ...] = ()
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    free_height: float = math.inf

    @property
    def polygon(self) -> np.ndarray:
        """f64[N, 2]: the outline as an array."""
        return np.array(self.outline, np.float64).reshape(-1, 2)

    @property
    def area(self) -> float:
        """Square metres."""
        return ring_area(self.outline) + sum(ring_area(hole) for hole in self.holes)

    @property
    def is_level(self) -> bool:
        """Whether its frame is the world's but for its height."""
        return self.quaternion == (1.0, 0.0, 0.0, 0.0)

    @property
    def tilt(self) -> float:
        """Radians between its normal and the vertical."""
        return math.acos(min(float(self.T_world_surface[2, 2]), 1.0))

    @property
    def lowest(self) -> float:
        """Metres: the height of its lowest point."""
        if self.is_level:
            return self.position[2]
        points = transform_points(self.pose, at_height(self.polygon, 0.0))
        return float(points[:, 2].min())

    @property
    def pose(self) -> np.ndarray:
        """f64[7]: where its frame is, position and wxyz."""
        return np.array((*self.position, *self.quaternion))

    def local(self, points: np.ndarray) -> np.ndarray:
        """f64[N, 3]: points of the world in its frame."""
        return (points - self.position) @ self.T_world_surface[:3, :3]

    @property
    def T_world_surface(self) -> np.ndarray:
        """f64[4, 4]."""
        T = np.eye(4)
        T[:3, :3] = rotation_matrix(np.array(self.quaternion))
        T[:3, 3] = self.position
        return T


@dataclass(frozen=True)
class SupportAsset:
    """A table, a shelf, a board. World frame: z up, origin on the floor below the support's centre.

    Attributes:
      boxes: its collision, with `parts`; every part of a flat top is among them.
      top: height of the surface that objects are asked for on, metres: of its frame's origin.
      region: the region queried by default on that surface, in its frame: the largest good rectangle, clear
        of rims and risers.
      pieces: what is drawn instead of the collision; empty means that the collision itself is drawn.
      parts: convex collision parts, world frame, beside the boxes.
      named: its surfaces, where it has other than a flat top alone.
      joints: its hinges and slides. They stand still wherever scenes are made, but for doors that are closed
        when all objects are placed (`assets.doors`).
      surface: those that objects are asked for on, as `on_surface` takes them: `top` and `region` tell of the
        first.
    """

    name: str
    label: str
    boxes: tuple[Box, ...]
    top: float
    region: Rectangle
    provenance: Provenance
    pieces: tuple[Piece, ...] = ()
    parts: tuple[Mesh, ...] = ()
    named: tuple[Surface, ...] = ()
    surface: str = ""
    joints: tuple[Joint, ...] = ()

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """All surfaces, the one used by default first. A flat top alone is called "top"."""
        if self.named:
            return self.named
        tops = [box.outline for box in self.level_boxes] or [self.region.corners]
        outline, *holes = outline_of_rectangles(tops)
        return (Surface("top", (0.0, 0.0, self.top), self.region, outline, tuple(holes)),)

    @property
    def level_boxes(self) -> list[Box]:
        """Those that end at the height of its top."""
        return [box for box in self.boxes if abs(box.top - self.top) < LEVEL]

    @property
    def asked(self) -> tuple[tuple[Surface, int], ...]:
        """The surfaces that objects are asked for on, and how many on each, 0 where that is left open."""
        return parse_surfaces(self.surface, self.surfaces)

    @property
    def chosen(self) -> Surface:
        """The surface that `top` and `region` tell of."""
        return self.asked[0][0]

    @property
    def collision_pieces(self) -> tuple[Piece, ...]:
        """All of its collision as surfaces in its colours, world frame: boxes, then convex parts."""
        boxes = [Piece(box.mesh, box.rgba) for box in self.boxes]
        return (*boxes, *(Piece(part.hull(), PART_RGBA) for part in self.parts))

    def on_top(self, flat: np.ndarray) -> np.ndarray:
        """f64[N, 3]: points f64[N, 2] of the surface that `region` lies on, world frame, metres."""
        if not self.named or self.chosen.is_level:
            return at_height(flat, self.top)
        return transform_points(self.chosen.pose, at_height(flat, 0.0))

    @property
    def region_points(self) -> np.ndarray:
        """f64[5, 3]: the middle of the region and its corners, world frame, metres."""
        return self.on_top(np.vstack([self.region.center, self.region.corners]))

    @property
    def lowest(self) -> float:
        """Metres: the height of the lowest point of the surfaces that objects are asked for on."""
        return min(each.lowest for each, _ in self.asked) if self.named else self.top

    def on_surface(self, text: str) -> SupportAsset:
        """The same support, objects being asked for on other surfaces of it; "" changes nothing.

        Args:
          text: a surface's name; "all"; several, joined by commas; or each with a number of objects, such as
            "top:3,shelf_1:4".

        Raises:
          ConfigError: it has no such surface, or a number is none.
        """
        asked = parse_surfaces(text, self.surfaces, self.name)
        if not text or not self.named:
            return self
        surface = asked[0][0]
        return replace(self, top=surface.position[2], region=surface.region, surface=text)


def parse_surfaces(
    text: str, surfaces: Sequence[Surface], support: str = "SUPPORT"
) -> tuple[tuple[Surface, int], ...]:
    """Those that `SupportAsset.on_surface` is asked for, with the number of objects on each, 0 for any.

    Raises:
      ConfigError: one is unknown or comes twice, or a number is none, or is missing where others have one.
    """
    if not text:
        return ((surfaces[0], 0),)
    found = {each.name: each for each in surfaces}
    example = ",".join(f"{name}:{number}" for number, name in enumerate(list(found)[:2], 3))
    words = list(found) if text == "all" else [word.strip() for word in text.split(",")]
    asked: dict[str, int] = {}
    for word in words:
        name, colon, number = word.partition(":")
        if name not in found:
            raise ConfigError(
                f"surface {name!r} of support {support!r}",
                f"{', '.join(found)}, or all",
                f"cluttergen inspect {support}, which draws them",
                closest(name, found),
            )
        if name in asked or (colon and not (number.isdecimal() and int(number) > 0)):
            allowed = "each once, with a whole number above 0"
            raise ConfigError(f"surfaces {text!r}", allowed, f"surface={example!r}")
        asked[name] = int(number) if colon else 0
    if 0 in asked.values() and any(asked.values()):
        allowed = "a number for each of them, or for none"
        raise ConfigError(f"surfaces {text!r}", allowed, f"surface={example!r}")
    return tuple((found[name], number) for name, number in asked.items())


MOST_SIDE = 10.0
"""Metres: of a table that is asked for by its size."""


def cuboid_table(width: float = 0.60, depth: float = 0.70, height: float = 0.70) -> SupportAsset:
    """The paper's table: one box whose whole top is the queried region (paper, section 4).

    Args:
      width, depth, height: metres along x, y and z, each in [0.02, 10].

    Raises:
      ConfigError: a size is out of range or not a number.
    """
    size = np.array([width, depth, height], np.float64)
    if not np.all(np.isfinite(size)) or size.min() < 0.02 or size.max() > MOST_SIDE:
        raise ConfigError(
            f"a table of {width} x {depth} x {height} m",
            f"each side between 0.02 and {MOST_SIDE:g} m",
            "sizes in metres, such as 0.60 x 0.70",
        )
    half = tuple(float(side) / 2 for side in size)
    return SupportAsset(
        name="table",
        label="cuboid table",
        boxes=(Box((0.0, 0.0, half[2]), (half[0], half[1], half[2])),),
        top=float(height),
        region=Rectangle((0.0, 0.0), (half[0], half[1]), 0.0),
        provenance=Provenance("cluttergen_jax", "Apache-2.0"),
    )


def _numbers(text: str, what: str, form: str) -> list[float]:
    try:
        values = [float(part) for part in re.split(r"[,x]", text.strip())]
    except ValueError as error:
        raise ConfigError(f"{what} {text!r}", form) from error
    if not all(math.isfinite(value) for value in values):
        raise ConfigError(f"{what} {text!r}", f"finite numbers: {form}")
    return values


_CORNERED = "X,Y,W,D or X,Y,W,D,YAW; metres and degrees, such as "


def parse_region(text: str, default: Rectangle) -> Rectangle:
    """A queried region: `WxD` about the default region's centre, or `X,Y,W,D[,YAW]` (metres, degrees).

    Raises:
      ConfigError: it is neither.
    """
    form = f"WxD, or {_CORNERED}0.4x0.5"
    values = _numbers(text, "region", form)
    if len(values) == 2:
        return Rectangle(default.center, (values[0] / 2, values[1] / 2), default.yaw)
    return _rectangle_of(values, f"region {text!r}", form)


def _rectangle_of(values: list[float], given: str, form: str) -> Rectangle:
    """The rectangle of X, Y, W, D and perhaps YAW, in degrees."""
    if len(values) not in (4, 5):
        raise ConfigError(given, form)
    x, y, width, depth, *yaw = values
    return Rectangle((x, y), (width / 2, depth / 2), math.radians(yaw[0]) if yaw else 0.0)


def parse_polygon(text: str, support: SupportAsset) -> tuple[Ring, Rectangle]:
    """A queried region that is a polygon, and the rectangle around it along the support's own region.

    Args:
      text: "outline", that of the surface; or at least three corners, X,Y;X,Y;X,Y, metres.

    Raises:
      ConfigError: it is neither.
    """
    ring = support.chosen.outline
    if text != "outline":
        form = "outline, or X,Y;X,Y;X,Y, metres, such as 0,0;0.3,0;0,0.3"
        corners = [_numbers(part, "region", form) for part in text.split(";") if part.strip()]
        if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
            raise ConfigError(f"region {text!r}", form)
        ring = tuple((corner[0], corner[1]) for corner in corners)
        if abs(ring_area(ring)) < _SMALLEST_AREA:
            raise ConfigError(f"region {text!r} of no area", form)
    yaw = support.region.yaw
    local = rotate_in_plane(ring, -yaw)
    low = local.min(0)
    high = local.max(0)
    x, y = rotate_in_plane((low + high) / 2, yaw).tolist()
    half = ((high - low) / 2).tolist()
    return ring, Rectangle((x, y), (half[0], half[1]), yaw)


def parse_keep_out(text: str) -> Rectangle:
    """A keep-out box, `X,Y,W,D[,YAW]` (metres, degrees).

    Raises:
      ConfigError: it is not.
    """
    form = f"{_CORNERED}0.1,0,0.2,0.2"
    return _rectangle_of(_numbers(text, "keep-out box", form), f"keep-out box {text!r}", form)


def parse_boxes(boxes: Sequence[Rectangle | str], argument: str) -> list[Rectangle]:
    """Keep-out boxes, each a rectangle or text.

    Raises:
      ConfigError: they are no sequence, or one of them is something else.
    """
    if isinstance(boxes, str | Rectangle):
        raise ConfigError(
            f"{argument} = {boxes!r}", "a sequence of boxes", f"{argument}=[{boxes!r}]"
        )
    return [parse_keep_out(box) if isinstance(box, str) else box for box in boxes]


def recorded_rectangle(entry: str | Mapping[str, Any]) -> Rectangle:
    """A rectangle of a bank's record: its fields, or a keep-out box in the words of a command line."""
    if isinstance(entry, str):
        return parse_keep_out(entry)
    return Rectangle(tuple(entry["center"]), tuple(entry["half_extents"]), float(entry["yaw"]))


def recorded_ring(entry: Any) -> Ring:
    """A polygon of a bank's record; none where there is no entry."""
    return tuple((float(x), float(y)) for x, y in entry)


def outline_of_rectangles(rectangles: Sequence[np.ndarray]) -> list[Ring]:
    """The largest of the areas that rectangles cover together, gaps of up to 2 cm bridged, then its holes.

    Args:
      rectangles: f64[4, 2] each, counter-clockwise.
    """
    if len(rectangles) == 1:
        return [_as_ring(rectangles[0])]
    # Loaded where it is needed: most supports are used without their outline.
    from manifold3d import CrossSection, JoinType

    united = CrossSection([np.asarray(each, np.float64) for each in rectangles])
    for reach in (_NARROW, -_NARROW):
        united = united.offset(reach, JoinType.Miter, 2.0)
    return _largest(united)


def outline_of_cells(
    mask: np.ndarray, origin: np.ndarray, cell: np.ndarray, tolerance: float
) -> list[Ring]:
    """The outline of the largest connected area of True cells, then its holes.

    Args:
      mask: bool[X, Y], something True; origin: f64[2], where cell (0, 0) begins; cell: f64[2], its sides.
      tolerance: metres by which corners may move to make straight what is a staircase.
    """
    from manifold3d import CrossSection

    runs = []
    for x, row in enumerate(mask):
        steps = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        for start, end in steps.reshape(-1, 2):
            low = origin + cell * (x, start)
            high = origin + cell * (x + 1, end)
            runs.append(box_corners(low, high))
    return _largest(CrossSection(runs).simplify(tolerance))


def ring_area(ring: Ring) -> float:
    """Square metres within a ring; below zero for a hole."""
    x, y = np.array(ring, np.float64).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _largest(section: object) -> list[Ring]:
    """The largest of the areas of a CrossSection: its outer ring, then its holes."""
    areas = section.decompose()  # type: ignore[attr-defined]
    rings = [_as_ring(each) for each in max(areas, key=lambda each: each.area()).to_polygons()]
    return sorted(rings, key=ring_area, reverse=True)


def _as_ring(points: np.ndarray) -> Ring:
    return tuple((float(x), float(y)) for x, y in points)
