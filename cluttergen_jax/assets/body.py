"""From a shape to a sound body."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from cluttergen_jax.assets.cloud import surface_cloud
from cluttergen_jax.assets.config import DecompositionConfig
from cluttergen_jax.assets.decompose import decompose, decompositions
from cluttergen_jax.assets.deviation import deviation, gap_alarm, size_alarm
from cluttergen_jax.assets.hollow import (
    MAX_FILL,
    HollowSpace,
    find_hollow,
    holds_ball,
    known_hollow,
)
from cluttergen_jax.assets.mass import MassProperties, choose_mass, mass_alarm, mass_properties
from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.assets.object import CLOUD_SIZE, ObjectAsset, Quality, RestingPose
from cluttergen_jax.assets.orientation import orient_faces
from cluttergen_jax.assets.parts import MAX_BASE_CORNERS, as_meshes, finish_parts, hull_of
from cluttergen_jax.assets.settle import resting_poses, settled_turn, tilt_of, upright_turn
from cluttergen_jax.assets.shape import Provenance, Shape
from cluttergen_jax.assets.solid import Solid, solid_of
from cluttergen_jax.assets.stances import upright_stance, usual_poses
from cluttergen_jax.assets.visuals import simplify_pieces
from cluttergen_jax.errors import AssetError, ConfigError
from cluttergen_jax.phases import say_phase

MAX_DEVIATION = 0.05
MAX_TILT = np.radians(15)
_FLAT = np.radians(0.5)
# Scans are drawn with fewer triangles than they have; below this share it is said.
_MUCH_FEWER = 0.5
_FEWER_CORNERS = (8, 6, 5, 4)
_FOOT_LOSS = 0.015
# How flags begin that hold for the pose alone.
NOT_STABLE = "placed alone it is stable in"
_OF_POSE = ("does not stand as authored", "its parts ", "a 10 mm ball", NOT_STABLE)
_NOWHERE = Provenance("draft", "none")


@dataclass(frozen=True)
class BodyConfig:
    """How bodies are made.

    Attributes:
      tier: "standard", or "light": one hull of at most 32 vertices.
      decomposition: CoACD's parameters.
      seed: of samples, clouds and random releases.
      jitter: see `decompose`; 0 but where a try was lost.
    """

    tier: str = "standard"
    decomposition: DecompositionConfig = field(default_factory=DecompositionConfig)
    seed: int = 0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        if self.tier not in ("standard", "light"):
            raise ConfigError(f"tier {self.tier!r}", "standard or light")


@dataclass(frozen=True, eq=False)
class _Candidate:
    """One set of parts for a shape, raw and in its resting orientation, and how good it is."""

    raw: list[np.ndarray]
    parts: list[np.ndarray]
    rotation: np.ndarray
    hollow: HollowSpace | None
    deviation: float
    fill: float | None
    holds: bool | None

    @property
    def is_open(self) -> bool:
        return self.fill is None or (self.fill <= MAX_FILL and bool(self.holds))

    @property
    def is_sound(self) -> bool:
        return (
            self.is_open and self.deviation <= MAX_DEVIATION and tilt_of(self.rotation) <= MAX_TILT
        )

    @property
    def rank(self) -> tuple[bool, bool, bool, float]:
        """Greater is better."""
        return (
            tilt_of(self.rotation) <= MAX_TILT,
            self.is_open,
            self.deviation <= MAX_DEVIATION,
            -self.deviation,
        )


def make_object(shape: Shape, config: BodyConfig | None = None) -> ObjectAsset:
    """The body of a shape: parts, mass, resting frame, cloud and what was measured about them.

    The author's own parts are taken if they are sound: nowhere farther than 5 % of the diagonal from the
    mesh, any cavity open, and upright by themselves. Else parts that follow from its shape (`exact_parts`),
    else CoACD's, halved where they are far from the mesh; the best of them is kept and its
    faults are flagged.

    Raises:
      AssetError: nothing with a volume can be made of the surfaces.
    """
    return next(object_variants(shape, config))


def with_mass(shape: Shape) -> tuple[Shape, Solid, MassProperties]:
    """The shape with a note on its mass if that is not taken as stated, its solid, and its mass.

    Raises:
      AssetError: nothing with a volume can be made of the surfaces.
    """
    solid = solid_of([piece.mesh for piece in shape.pieces])
    mass = mass_properties(solid.mesh, shape.density, shape.mass)
    if shape.mass is None and shape.stated is not None:
        mass, refusal = choose_mass(shape.stated, solid.mesh, mass, shape.density)
        shape = replace(shape, notes=(*shape.notes, *([refusal] if refusal else ())))
    return shape, solid, mass


def object_variants(shape: Shape, config: BodyConfig | None = None) -> Iterator[ObjectAsset]:
    """`make_object`'s body, then the same with ever fewer corners on the plane on which it stands.

    For callers that measure its stability: some outlines make MuJoCo change its choice of contacts from step
    to step. They are yielded as they are made; the parts are found only once.
    """
    config = config or BodyConfig()
    shape, solid, mass = with_mass(shape)
    if shape.is_pose_free and (turn := _usual_turn(shape.stated_up, solid, mass)) is not None:
        rotation, note = turn
        shape = replace(shape, notes=(*shape.notes, note))
        if rotation is not None:
            shape = shape.rotate(rotation)
            solid = solid.rotate(rotation)
            mass = mass.transform(rotation)
    best: _Candidate | None = None
    first: _Candidate | None = None
    for family in _proposals(shape, solid, config):
        for candidate in _candidates(
            family, lambda raw: _candidate(raw, shape, solid, mass, config)
        ):
            first = first or candidate
            if best is None or candidate.rank > best.rank:
                best = candidate
        if best is not None and best.is_sound:
            break
    if best is None or first is None:
        raise AssetError(f"{shape.label!r} has no convex part")
    if shape.parts and best is not first:
        text = f"its file's own parts were not taken ({'; '.join(_faults(first, config))})"
        shape = replace(shape, notes=(*shape.notes, text))
    yield _asset(shape, solid, mass, best, config)
    for corners in _FEWER_CORNERS:
        fewer = _candidate(best.raw, shape, solid, mass, config, corners)
        if best.rank[:3] == fewer.rank[:3]:
            yield _asset(shape, solid, mass, fewer, config)


def turned_variants(asset: ObjectAsset, rotation: np.ndarray) -> Iterator[ObjectAsset]:
    """The same body set down after a turn, its bottom made flat there; then with ever fewer corners on it.

    Args:
      rotation: f64[3, 3], takes the direction of the object frame that is to point up to z.

    Raises:
      AssetError: it does not stand so.
    """
    config = BodyConfig(tier=asset.tier)
    shape = Shape(asset.name, asset.label, asset.pieces, asset.provenance).rotate(rotation)
    solid = solid_of([piece.mesh for piece in shape.pieces])
    own_mass = MassProperties(asset.mass, asset.center_of_mass, asset.inertia)
    mass = own_mass.transform(rotation)
    raw = [part.vertices @ rotation.T for part in asset.parts]
    flags = tuple(flag for flag in asset.flags if not flag.startswith(_OF_POSE))
    loose = replace(asset, pieces=shape.pieces, cloud=asset.cloud @ rotation.T, flags=flags)
    for corners in (MAX_BASE_CORNERS, *_FEWER_CORNERS):
        candidate = _candidate(raw, shape, solid, mass, config, corners)
        if tilt_of(candidate.rotation) > MAX_TILT:
            raise AssetError(f"{asset.name!r} does not stand so", "another of its poses")
        kept = asset.quality.deviation
        best = candidate if kept is None else replace(candidate, deviation=kept)
        yield _set_down(loose, mass, best, config)


def _usual_turn(
    stated: str, solid: Solid, mass: MassProperties
) -> tuple[np.ndarray | None, str] | None:
    """The turn into the pose in which people put an object, and a note on it; None to stay as authored.

    A pose is taken if the object's hull stays there in plain MuJoCo. The authored pose is not left where its
    file states it, it bears a tilt of 5 degrees and the hull stays in it: then there is a note and no turn.

    Args:
      stated: see `Shape.stated_up`.
    """
    choice = usual_poses(solid, mass.center)
    for stance, _ in () if choice.is_kept else choice.poses:
        if stance is choice.authored:
            break
        turn = upright_turn(stance.up)
        if not _stays(solid, mass, turn):
            continue
        tilt = f"turned by {np.degrees(tilt_of(turn)):.0f} degrees"
        reason = "its file does not say which way is up"
        if stated:
            own = upright_stance(solid.mesh.vertices, mass.center, MAX_TILT)
            if own is not None and _stays(solid, mass, np.eye(3)):
                bears = f"up to a tilt of {np.degrees(own.tip):.0f} degrees"
                other = f"{tilt} it would be {1000 * stance.height:.0f} mm tall"
                return None, f"it stands as its file states ({stated}), {bears}; {other}"
            reason = f"as its file states ({stated}) it does not stand"
        heights = [f"{1000 * each.height:.0f}" for each, _ in choice.poses if each is not stance]
        others = f"; it would rest {', '.join(heights[:4])} mm tall as well" if heights else ""
        return (
            turn,
            f"{tilt}, as people put it: {1000 * stance.height:.0f} mm tall{others}; {reason}",
        )
    return None


def _stays(solid: Solid, mass: MassProperties, turn: np.ndarray) -> bool:
    """Whether the object's hull stays in plain MuJoCo as it is set down after a turn, to `MAX_TILT`."""
    hull = finish_parts([solid.mesh.vertices @ turn.T], MAX_BASE_CORNERS)
    return tilt_of(_settling_turn(hull, mass.transform(turn))) <= MAX_TILT


def _candidates(
    family: list[list[np.ndarray]], judge: Callable[[list[np.ndarray]], _Candidate]
) -> Iterator[_Candidate]:
    """The first of a family that is sound, after those that were looked at before.

    Each look costs as much as a short cut, and where the nearest set is not sound, those between hardly are.
    """
    first = judge(family[0])
    yield first
    if first.is_sound or len(family) == 1:
        return
    last = judge(family[-1])
    for raw in family[1:-1] if last.is_sound else ():
        between = judge(raw)
        yield between
        if between.is_sound:
            return
    yield last


def _proposals(shape: Shape, solid: Solid, config: BodyConfig) -> Iterator[list[list[np.ndarray]]]:
    """Families of sets of raw parts in the authored frame, the cheapest first."""
    if config.tier == "light":
        yield [decompose(solid, replace(config.decomposition, max_parts=1))]
        return
    own = [part.vertices for part in shape.parts or () if hull_of(part.vertices) is not None]
    if own:
        yield [own]
        if shape.keeps_parts:
            return
    yield from decompositions(solid, config.decomposition, config.jitter)


def _candidate(
    raw: list[np.ndarray],
    shape: Shape,
    solid: Solid,
    mass: MassProperties,
    config: BodyConfig,
    corners: int = MAX_BASE_CORNERS,
) -> _Candidate:
    say_phase(f"measuring its convex parts ({len(raw)})")
    # Who models an object knows what its feet need.
    parts, rotation = _at_rest(raw, mass, corners, _FOOT_LOSS if shape.is_from_file else np.inf)
    turned = solid.rotate(rotation)
    if shape.cavity is not None:
        hollow: HollowSpace | None = known_hollow(shape.cavity).rotate(rotation)
    elif shape.parts is not None and not shape.is_from_file:
        # A modelled object without a cavity has none.
        hollow = None
    else:
        hollow = None if solid.is_convex else find_hollow(turned)
    is_judged = hollow is not None and config.tier == "standard"
    return _Candidate(
        raw=raw,
        parts=parts,
        rotation=rotation,
        hollow=hollow,
        deviation=deviation(parts, turned, config.seed),
        fill=hollow.fill(parts) if hollow is not None else None,
        holds=holds_ball(parts, hollow) if hollow is not None and is_judged else None,
    )


def _at_rest(
    raw: list[np.ndarray], mass: MassProperties, corners: int, foot_loss: float
) -> tuple[list[np.ndarray], np.ndarray]:
    """Finished parts in the orientation in which they come to rest, and the turn from the authored one.

    The bottom is made flat in the pose found without flattening, so that a leaning object is not cut
    to its lean; only if it topples is the bottom of the authored pose tried.
    """

    def finish(rotation: np.ndarray) -> list[np.ndarray]:
        turned = [points @ rotation.T for points in raw]
        return finish_parts(turned, corners, foot_loss=foot_loss)

    rotation = _settling_turn(finish_parts(raw, None), mass)
    if tilt_of(rotation) > MAX_TILT:
        kept = _settling_turn(finish_parts(raw, corners, foot_loss=foot_loss), mass)
        rotation = kept if tilt_of(kept) < tilt_of(rotation) else rotation
    for _ in range(4):
        parts = finish(rotation)
        more = _settling_turn(parts, mass.transform(rotation))
        if tilt_of(more) < _FLAT:
            return parts, rotation
        rotation = more @ rotation
    return finish(rotation), rotation


def _settling_turn(parts: list[np.ndarray], mass: MassProperties) -> np.ndarray:
    """f64[3, 3]: the turn by which a body of these parts tilts when it is set down."""
    return settled_turn(_draft(parts, mass))


def _draft(parts: list[np.ndarray], mass: MassProperties) -> ObjectAsset:
    """Just enough of an asset to be simulated."""
    return ObjectAsset(
        name="draft",
        label="",
        pieces=(),
        parts=as_meshes(parts),
        mass=mass.mass,
        center_of_mass=mass.center,
        inertia=mass.inertia,
        cloud=np.zeros((CLOUD_SIZE, 3), np.float32),
        resting=(RestingPose((1.0, 0.0, 0.0, 0.0), 0.0, 1.0),),
        provenance=_NOWHERE,
    )


def _asset(
    shape: Shape, solid: Solid, mass: MassProperties, best: _Candidate, config: BodyConfig
) -> ObjectAsset:
    surfaces = simplify_pieces(shape.pieces)
    num_drawn = sum(len(piece.mesh.faces) for piece in surfaces)
    notes = shape.notes
    if num_drawn < _MUCH_FEWER * len(solid.surface.faces):
        notes = (*notes, f"drawn with {num_drawn:,} of its {len(solid.surface.faces):,} triangles")
    loose = replace(
        _draft([], mass),
        name=shape.name,
        label=shape.label,
        synset=shape.synset,
        pieces=orient_faces(surfaces, solid),
        cloud=surface_cloud(solid, config.seed),
        provenance=shape.provenance,
        tier=config.tier,
        flags=tuple(_alarms(shape, solid)),
        notes=notes,
        friction=shape.friction,
        scale=shape.scale,
    )
    return _set_down(loose, mass, best, config)


def _set_down(
    loose: ObjectAsset, mass: MassProperties, best: _Candidate, config: BodyConfig
) -> ObjectAsset:
    """The asset whose surfaces are given, with the parts of a candidate, in the pose of that."""
    vertices = np.concatenate(best.parts)
    shift = -(vertices.min(0) + vertices.max(0)) / 2
    rotation = best.rotation
    moved = mass.transform(rotation, shift)
    asset = replace(
        loose,
        pieces=tuple(piece.transform(rotation, shift) for piece in loose.pieces),
        parts=as_meshes([points + shift for points in best.parts]),
        mass=moved.mass,
        center_of_mass=moved.center,
        inertia=moved.inertia,
        cloud=(loose.cloud @ rotation.T + shift).astype(np.float32),
        quality=Quality(
            deviation=round(best.deviation, 5),
            cavity_fill=None if best.fill is None else round(best.fill, 4),
            holds_ball=best.holds,
        ),
        flags=(*loose.flags, *_faults(best, config)),
    )
    return replace(asset, resting=resting_poses(asset, config.seed))


def _alarms(shape: Shape, solid: Solid) -> Iterator[str]:
    """Where an object's file contradicts itself: what it holds may not be the object that is meant."""
    colliding = shape.colliding or shape.parts
    if colliding and (alarm := size_alarm(solid.surface.vertices, join_meshes(colliding).vertices)):
        yield alarm
    if alarm := gap_alarm(solid):
        yield alarm
    if (
        shape.mass is None
        and shape.stated is not None
        and (alarm := mass_alarm(shape.stated, solid.mesh))
    ):
        yield alarm


def _faults(best: _Candidate, config: BodyConfig) -> Iterator[str]:
    tilt = np.degrees(tilt_of(best.rotation))
    if tilt > np.degrees(MAX_TILT):
        yield f"does not stand as authored: it came to rest turned by {tilt:.0f} degrees"
    if config.tier == "light":
        return
    if best.deviation > MAX_DEVIATION:
        yield f"its parts are up to {100 * best.deviation:.1f} % of its size away from its surface"
    if best.fill is not None and best.fill > MAX_FILL:
        yield f"its parts cover {100 * best.fill:.0f} % of its cavity"
    if best.holds is False:
        yield "a 10 mm ball dropped at its mouth does not come to rest inside"
