"""What a reader or the modeller hands to the importer: an object before it is a body, and its images."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from PIL import Image

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.mesh import ORIGIN, Mesh
from cluttergen_jax.errors import AssetError

if TYPE_CHECKING:
    # Of use to importers alone, and slow to load.
    from cluttergen_jax.assets.mass import MassProperties, StatedMass


_FLAT = 1e-5
"""Metres."""


@dataclass(frozen=True)
class Texture:
    """An image for surfaces. Textures of equal bytes are equal.

    Attributes:
      data: a PNG file, RGB, 8 bits a channel, as shown (sRGB); of a map of a `Finish`, linear.
    """

    data: bytes

    @staticmethod
    def of(image: Image.Image, max_side: int = MAX_TEXTURE, fast: bool = False) -> Texture:
        """The image, shrunk until no side is longer than `max_side` pixels; transparency is dropped.

        Args:
          fast: pack it quickly; the file is half as large again.

        Raises:
          AssetError: its file is broken.
        """
        try:
            # A JPEG file can be read at a fraction of its size.
            image.draft("RGB", (max_side, max_side))
            pixels = image.convert("RGB")
        except (
            OSError,
            ValueError,
            SyntaxError,
            MemoryError,
            Image.DecompressionBombError,
        ) as error:
            raise AssetError(f"an image that cannot be decoded ({error})") from error
        pixels.thumbnail((max_side, max_side), Image.Resampling.LANCZOS)
        buffer = io.BytesIO()
        pixels.save(buffer, "PNG", compress_level=1 if fast else 6)
        return Texture(buffer.getvalue())

    @cached_property
    def digest(self) -> str:
        """Hex SHA-256 of the file."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def file_name(self) -> str:
        """What it is called wherever it is stored: equal images have equal names."""
        return texture_name(self.digest)

    @cached_property
    def image(self) -> Image.Image:
        """The image, decoded; not to be changed.

        Raises:
          ValueError: the bytes are no PNG image.
        """
        try:
            image = Image.open(io.BytesIO(self.data), formats=["PNG"])
            return image.convert("RGB")
        except (OSError, SyntaxError, MemoryError, Image.DecompressionBombError) as error:
            raise ValueError(f"a texture that is no PNG image ({error})") from error

    def at(self, uv: np.ndarray) -> np.ndarray:
        """f64[N, 3], in [0, 1]: the nearest pixel's colour at f[N, 2]; the image is repeated beyond [0, 1].

        (0, 0) is the lower left corner of the image, (1, 1) the upper right one.
        """
        pixels = np.asarray(self.image)
        height, width = pixels.shape[:2]
        u, v = np.mod(np.asarray(uv, np.float64), 1.0).T
        x = np.minimum((u * width).astype(int), width - 1)
        y = np.minimum(((1 - v) * height).astype(int), height - 1)
        return pixels[y, x] / 255.0


def texture_name(digest: str) -> str:
    """The file name of the image whose bytes have that SHA-256."""
    return f"texture-{digest[:12]}.png"


@dataclass(frozen=True, eq=False)
class Piece:
    """One surface of an object, of one colour or with an image on it.

    Attributes:
      mesh: in the shape's authored frame, z up, metres.
      rgba: each in [0, 1], sRGB as shown. With a texture, what its colours are multiplied by.
      uv: f32[V, 2], for each vertex its place in the images, (0, 0) being the lower left corner; images are
        repeated beyond [0, 1]. A vertex on a seam of an image comes once for each side. Given where there is
        an image, `texture` or one of `finish`, and nowhere else.
      texture: the image of its colours.
      colours: u8[V, 3], sRGB, a colour for each vertex that `rgba` multiplies, until an image is made of them
        (`visuals.bake_colours`); never beside an image.
      baked_side: pixels a side that the image may have, where it was made so; 0 for other images.
      finish: how it reflects light; None where its file says nothing.
    """

    mesh: Mesh
    rgba: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    uv: np.ndarray | None = None
    texture: Texture | None = None
    colours: np.ndarray | None = None
    baked_side: int = 0
    finish: Finish | None = None

    def __post_init__(self) -> None:
        if self.colours is not None and (
            self.uv is not None or len(self.colours) != len(self.mesh.vertices)
        ):
            raise ValueError("colours beside an image, or not of every vertex")
        if (self.uv is None) == bool(self.images):
            raise ValueError("a piece with an image but no uv, or the other way round")
        if self.uv is not None:
            uv = np.asarray(self.uv, np.float32)
            if uv.shape != (len(self.mesh.vertices), 2) or not np.isfinite(uv).all():
                raise ValueError(
                    f"uv {uv.shape} of {len(self.mesh.vertices)} vertices, or not finite"
                )
            object.__setattr__(self, "uv", uv)

    @property
    def images(self) -> tuple[Texture, ...]:
        """All images that lie on it: that of its colours and the maps of its finish."""
        colours = () if self.texture is None else (self.texture,)
        return colours if self.finish is None else (*colours, *self.finish.images)

    @property
    def without_maps(self) -> Piece:
        """The piece with a finish of numbers alone; what has no image then has no uv."""
        if self.finish is None:
            return self
        uv = None if self.texture is None else self.uv
        return replace(self, uv=uv, finish=self.finish.without_maps)

    def transform(self, rotation: np.ndarray, translation: np.ndarray = ORIGIN) -> Piece:
        """The piece with its mesh transformed: see `Mesh.transform`."""
        return replace(self, mesh=self.mesh.transform(rotation, translation))

    @cached_property
    def is_flat(self) -> bool:
        """Whether it lies in a plane, so that it has no volume about its own middle: such as a sticker."""
        normals = self.mesh.normals
        areas = self.mesh.areas
        if not areas.any():
            return True
        centers = self.mesh.corners.mean(1)
        apart = centers - np.average(centers, axis=0, weights=areas)
        return bool(np.abs((normals * apart).sum(1)).sum() <= _FLAT * areas.sum())

    @property
    def mean_rgba(self) -> tuple[float, float, float, float]:
        """One colour for the whole: `rgba`, times the mean over the vertices of what it multiplies."""
        if self.colours is not None:
            mean = self.colours.mean(0) / 255
        elif self.uv is not None and self.texture is not None:
            mean = self.texture.at(self.uv).mean(0)
        else:
            return self.rgba
        r, g, b = (mean * self.rgba[:3]).tolist()
        return (r, g, b, self.rgba[3])


@dataclass(frozen=True)
class Cavity:
    """The hollow of a cup, a bowl, a pot or a holder.

    Attributes:
      solid: a closed mesh of the space inside, in the authored frame, up to the rim's plane.
      mouth: the point in the opening's plane, over the middle of the cavity, where a ball can be dropped in.
    """

    solid: Mesh
    mouth: tuple[float, float, float]


@dataclass(frozen=True)
class Joint:
    """A joint of furniture, where it stands.

    Attributes:
      name: as in its file. kind: what it does.
      anchor, axis: a point on its axis, metres, and the axis' direction, of length 1; in the frame of what it
        belongs to, and as it stands.
      value: where it stands, metres or radians, as its file counts. range: its limits, None without any.
      parent: the joint by which it is moved itself, by number; -1 for none.
      pieces: the numbers of the surfaces that it moves, those of joints that hang on it not included.
      boxes, parts: likewise of a support's collision.
      mass, center, inertia: of what moves with it, joints that hang on it not included: kilograms, metres in
        the frame of `anchor`, and xx, yy, zz, xy, xz, yz about the centre, kg m^2; None where its file states
        none that can be.
      damping, friction, armature: N s/m, N and kg, or of hinges N m s, N m and kg m^2; None where its file
        states none.
      closed: where it stands when it is closed, as `value`: of doors and drawers that scenes open to place
        objects behind them; None of all others.
    """

    name: str
    kind: Literal["hinge", "slide"]
    anchor: tuple[float, float, float]
    axis: tuple[float, float, float]
    value: float
    range: tuple[float, float] | None = None
    parent: int = -1
    pieces: tuple[int, ...] = ()
    boxes: tuple[int, ...] = ()
    parts: tuple[int, ...] = ()
    mass: float | None = None
    center: tuple[float, float, float] | None = None
    inertia: tuple[float, float, float, float, float, float] | None = None
    damping: float | None = None
    friction: float | None = None
    armature: float | None = None
    closed: float | None = None

    def with_mass(self, body: MassProperties | None) -> Joint:
        """The joint with the mass of what it moves, if it is known."""
        if body is None:
            return self
        x, y, z = body.center.tolist()
        xx, yy, zz, xy, xz, yz = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()
        return replace(
            self, mass=float(body.mass), center=(x, y, z), inertia=(xx, yy, zz, xy, xz, yz)
        )

    @property
    def body(self) -> MassProperties | None:
        """What it moves; None where that is not known."""
        if self.mass is None or self.center is None or self.inertia is None:
            return None
        from cluttergen_jax.assets.mass import MassProperties

        xx, yy, zz, xy, xz, yz = self.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return MassProperties(self.mass, np.array(self.center), inertia)

    def transform(
        self, rotation: np.ndarray, scale: float, translation: np.ndarray, mass: float = 1.0
    ) -> Joint:
        """The joint of a shape whose points p are at scale * rotation @ p + translation.

        Args:
          mass: the factor on masses.
        """
        factor = scale if self.kind == "slide" else 1.0
        x, y, z = (scale * rotation @ self.anchor + translation).tolist()
        u, v, w = (rotation @ self.axis).tolist()
        limits = None if self.range is None else (factor * self.range[0], factor * self.range[1])
        closed = None if self.closed is None else factor * self.closed
        moved = replace(
            self,
            anchor=(x, y, z),
            axis=(u, v, w),
            value=factor * self.value,
            range=limits,
            closed=closed,
        )
        if (body := self.body) is None:
            return moved
        placed = body.transform(scale * rotation, translation)
        return moved.with_mass(
            replace(placed, mass=body.mass * mass, inertia=mass * placed.inertia)
        )


@dataclass(frozen=True)
class Provenance:
    """Where a shape comes from and on which terms it may be passed on.

    Attributes:
      outside: files that its own file took from outside its folder, the last steps of their paths.
    """

    source: str
    licence: str
    attribution: str = ""
    outside: tuple[str, ...] = ()

    def record(self) -> dict[str, Any]:
        """As JSON values; without `outside` where there is none, as records of older versions are."""
        fields = {"source": self.source, "licence": self.licence, "attribution": self.attribution}
        return {**fields, "outside": list(self.outside)} if self.outside else fields


@dataclass(frozen=True)
class Shape:
    """An object as authored: surfaces, and whatever its author knows about its body.

    Attributes:
      name: a short identifier, `[a-z0-9_-]+`.
      label: what people call it, e.g. "coffee mug".
      pieces: the coloured surfaces. Watertight where the author can promise it.
      parts: the author's own convex parts, at most 32 vertices each; None means they have to be found.
      cavity: given where the object is hollow and known to be.
      mass: kilograms, or None to take it from `stated` or `density`.
      density: kg/m^3 of the solid material, used if the mass is not known otherwise.
      stated: mass and inertia as the object's own file has them, not yet believed.
      friction: sliding coefficient wherever the object touches something; None for the contact's.
      notes: what its reader decided on the user's behalf, in words.
      colliding: all that collides according to its file, whether or not it can serve as `parts`.
      scale: the factor on the file's lengths that was asked for.
      is_pose_free: whether its authored pose may give way to the one in which people put it (`stances`).
      stated_up: what its file states about the vertical axis, in words; such a pose gives way only where the
        object does not stand so. Empty if the file says nothing.
      is_from_file: whether a file is all that is known of it: whether it is hollow is looked for.
      synset: what kind of thing it is: a WordNet synset such as mug.n.04, or another word; empty if unknown.
      keeps_parts: whether `parts` are asked for, sound or not.
      joints: of furniture that was read with its joints.
    """

    name: str
    label: str
    pieces: tuple[Piece, ...]
    provenance: Provenance
    parts: tuple[Mesh, ...] | None = None
    cavity: Cavity | None = None
    mass: float | None = None
    density: float = 500.0
    stated: StatedMass | None = None
    friction: float | None = None
    notes: tuple[str, ...] = ()
    colliding: tuple[Mesh, ...] = ()
    scale: float = 1.0
    is_pose_free: bool = False
    stated_up: str = ""
    is_from_file: bool = False
    keeps_parts: bool = False
    synset: str = ""
    joints: tuple[Joint, ...] = ()

    def rotate(self, rotation: np.ndarray) -> Shape:
        """The shape with every point p at rotation @ p."""
        cavity = self.cavity
        if cavity is not None:
            x, y, z = (rotation @ cavity.mouth).tolist()
            cavity = Cavity(cavity.solid.transform(rotation), (x, y, z))
        return replace(
            self,
            pieces=tuple(piece.transform(rotation) for piece in self.pieces),
            parts=None if self.parts is None else rotate_meshes(self.parts, rotation),
            cavity=cavity,
            stated=None if self.stated is None else self.stated.convert(rotation, 1.0),
            colliding=rotate_meshes(self.colliding, rotation),
        )


def rotate_meshes(meshes: tuple[Mesh, ...], rotation: np.ndarray) -> tuple[Mesh, ...]:
    """Meshes with every point p at rotation @ p."""
    return tuple(mesh.transform(rotation) for mesh in meshes)
