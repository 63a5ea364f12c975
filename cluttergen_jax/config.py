"""The numbers that decide verdicts, and the words that settings take. One frozen default, in one place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Literal, get_args

from cluttergen_jax.errors import ConfigError, closest, range_text

if TYPE_CHECKING:
    from cluttergen_jax.schema import Record

# The words of settings stand where nothing heavy is imported: the command line offers them as choices.
Method = Literal[
    "random",
    "settle",
    "clear",
    "drop",
    "spread",
    "guided",
    "packed",
    "pile",
    "policy",
    "beta_free",
    "normal",
    "open_loop",
    "short_memory",
]
"""What is known of each stands in `placement.methods.table`."""
SETTLE = "settle"
"""The plain loop that others have to beat."""
# Ways to clutter that are no rivals of the others and stand in no table: objects shoulder to shoulder; and
# all objects of a scene let fall into a heap, which the native engine makes whole.
PACKED = "packed"
PILE = "pile"
Together = Literal["pile", "crowd", "drop"]
"""How the native engine makes a scene as a whole: a heap, objects drawn together, or dropped one by one."""

PILE_NOSLIP = 4
"""No-slip iterations of piles. Without them friction yields a little, and some heaps slide after seconds."""
AIR_WALLS = ("air-x", "air+x", "air-y", "air+y")
"""Planes by the side of a region on which they stand."""
HAND = "hand"
"""The method of banks that people made; it proposes nothing by itself."""
REPAIR = "repair"
"""That of banks of repaired layouts."""
UNPROPOSED = (HAND, REPAIR)
Variant = Literal["guided", "policy", "beta_free", "normal", "open_loop", "short_memory"]
"""`guided` is no policy: its network learns by supervision what will stand, for every pool.

`policy` is the full method with the preset's head (a mixture; in the paper's presets its Beta a coordinate);
`beta_free`, the paper's, and `normal` are the full method with one distribution a coordinate;
`open_loop` and `short_memory` look back on nothing and on one attempt."""
Preset = Literal["cpu", "gpu", "paper", "paper_code", "paper_cpu"]
Engine = Literal["auto", "native", "warp", "jax"]
ENGINES: tuple[Engine, ...] = get_args(Engine)
Order = Literal["random", "fixed", "largest", "weighted"]
Setting = Literal["default", "paper"]
DatasetForm = Literal["parquet", "webdataset", "bop", "coco", "yolo", "yolo-seg"]
Variation = Literal["texture", "light", "colour"]
"""What pictures of a dataset may vary in: the table's texture, light, colours of objects and floor."""
Balance = Literal["objects", "label", "synset", "licence", "source"]
Containment = Literal["center", "footprint"]
Overhang = Literal["any", "half", "none"]
Height = Literal["rest", "free"]
Poses = Literal["upright", "resting", "usual", "any"]
DoorState = Literal["open", "closed"]
Seat = Literal["-y", "+y", "-x", "+x"]
OtherEngine = Literal["drake", "pybullet", "isaac"]
RelationKind = Literal[
    "on", "in", "next_to", "far_from", "left_of", "right_of", "in_front_of", "behind", "aligned"
]
Change = Literal["none", "translation", "rotation", "shrinkage", "expansion", "all"]
Reward = Literal["paper", "code", "compressed"]
Encoder = Literal["set", "pointnet", "pointnet2"]
EvalAction = Literal["sampled", "mean"]
Suite = Literal["paper", "extended", "downstream"]
Axis = Literal["auto", "x", "y", "z", "-x", "-y", "-z"]
Up = Literal["auto", "file", "x", "y", "z", "-x", "-y", "-z"]
Tier = Literal["standard", "light"]
Quality = Literal["standard", "fine"]
"""Of convex parts: as few as describe an object well, or more for a closer fit."""
ByVolume = Literal["volume"]
"""Of a mass: volume times density, whatever a file states."""
Collision = Literal["auto", "keep"]
CameraName = Literal["overhead", "front", "side", "wrist"]
FilmFormat = Literal["gif", "mp4"]
PixelOrigin = Literal["center", "corner"]
"""Where pixel coordinates (0, 0) are in the first pixel."""
ExportFormat = Literal[
    "mjcf",
    "urdf",
    "sdf",
    "usd",
    "glb",
    "maniskill",
    "robosuite",
    "libero",
    "robocasa",
    "molmospaces",
    "moveit",
    "rerun",
    "mjlab",
    "playground",
    "lerobot",
]


def no_such(what: str, name: str, known: Iterable[str]) -> ConfigError:
    """The error for an unknown name of a method, a variant or a preset."""
    known = tuple(known)
    return ConfigError(f"{what} {name!r}", ", ".join(known), meant=closest(name, known))


def check_engine(engine: str) -> None:
    """Refuses what is no engine (ConfigError)."""
    if engine not in ENGINES:
        raise ConfigError(
            f"engine = {engine!r}",
            ", ".join(ENGINES),
            "engine native, which runs everywhere",
            closest(engine, ENGINES),
        )


def check_range(name: str, value: int, least: int, most: int, example: int) -> None:
    """Refuses what is no whole number from `least` to `most` (ConfigError)."""
    check_whole(**{name: value})
    if not least <= value <= most:
        raise ConfigError(f"{name} = {value}", range_text(least, most), f"{name}={example}")


def check_whole(**numbers: object) -> None:
    """Refuses what is no whole number; None is let through."""
    for name, value in numbers.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, Integral)):
            raise ConfigError(f"{name} = {value!r}", "a whole number")


def check_names(names: Sequence[object], argument: str) -> None:
    """Refuses a single name, whose letters would be taken for names."""
    if isinstance(names, str):
        raise ConfigError(
            f"{argument} = {names!r}", "a sequence of names", f"{argument}=({names!r},)"
        )


def _is_positive(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and 0 < float(value) < math.inf


def check_positive(config: object, *names: str) -> None:
    """Refuses fields of a config that are not finite numbers above zero (ConfigError)."""
    for name in names:
        value = getattr(config, name)
        if not _is_positive(value):
            raise ConfigError(
                f"{type(config).__name__}.{name} = {value!r}",
                "a finite number above zero",
                f"leaving {name} at its default",
            )


MAX_WORKERS = 4096


def check_workers(argument: str, number: int) -> None:
    """Refuses a number of threads or processes that cannot be meant; 0 takes every core (ConfigError)."""
    if (
        isinstance(number, bool)
        or not isinstance(number, Integral)
        or not 0 <= number <= MAX_WORKERS
    ):
        raise ConfigError(
            f"{argument} = {number!r}",
            f"0 to {MAX_WORKERS}, a whole number",
            f"{argument}=0, which takes every core",
        )


Detector = Literal["native", "libccd"]
DETECTORS: tuple[Detector, ...] = get_args(Detector)
"""MuJoCo's detectors of convex collisions: its own, the default since 3.3, and the older one, the default
before (`<flag nativeccd="disable"/>`). They name other contact points: some heaps stand with one alone."""

ROBUST_TILT = math.radians(5)
"""Radians by which gravity is tilted where robust scenes are asked for (`StabilityConfig.robust_tilt`). Its
direction stays nowhere for long: passing by at 4 degrees it finds what would fall at a lasting 3."""

ROBUST_MARGIN = 5e-5
"""Metres at which contacts of robust scenes begin in their files. With none the native detector of MuJoCo
3.3 to 3.10 gives all contact points of two faces one depth, and what lies askew creeps; with any it looks
for them one by one. With 0.01 mm 3.3.7 misjudges some depths and throws an object in one heap of twelve,
with 0.05 mm in none of 128. libccd, which files choose, needs none, and with one now and then finds two
boxes millimetres deep in each other: so robust scenes are checked with it, and others have none."""


@dataclass(frozen=True)
class StabilityConfig:
    """When an object stands still, and when a finished scene does (paper, section 3; made stricter).

    Attributes:
      timestep: seconds per simulation step.
      max_steps: an attempt's last step.
      quiet_steps: how many quiet steps in a row end an attempt.
      settle_steps: how many steps may pass before those; stable means quiet by settle_steps + quiet_steps.
      max_speed: m/s. A step is quiet if all four motions of the object's origin are below their limits.
      max_acceleration: m/s^2, the velocity's difference over one step.
      max_angular_speed: rad/s.
      max_angular_acceleration: rad/s^2.
      per_axis: compare every axis alone, as the published code does, instead of Euclidean norms.
      stop_when_decided: end an attempt at the last step at which it could still have become stable.
      judge_neighbours: ask that placed objects stay put and nothing penetrates. Without it only the
        current object is judged and the others are put back: the paper's looser count.
      max_shift: metres that a placed object may move during an attempt.
      max_turn: radians that a placed object may turn during an attempt.
      max_penetration: metres that any two bodies may overlap at the end of an attempt.
      max_added_penetration: metres by which a pair may overlap more than it did at rest before the attempt.
      stand_steps: first stage of the last check, everything awake.
      stand_shift, stand_turn: metres and radians; a scene that moved less in the first stage stands.
      stand_full_steps: second stage of the last check, for the others.
      stand_full_shift, stand_full_turn: metres and radians allowed by the end of the second stage.
      both_detectors: what the last check and the slight disturbance ask is asked with each of MuJoCo's two
        detectors of convex collisions (`DETECTORS`), not with its own choice alone; native engine only.
      decide_alone: what is let go upright on a level top, with nothing else within reach, is not simulated:
        how an object settles there is simulated once, in some turns (`physics.alone`); and what rests there
        so is not asked of the second detector again. Native engine only.
      side_support: support margins count what holds an object from its sides (`physics.margin.held_margin`).
      lower_releases: what is let go is lowered first, to just above what it touches there: over a hollow the
        height maps of searches are too high; native engine only.
      robust_tilt: radians; above 0, what came to rest must also stand while gravity, tilted by so much, turns
        once around (`native.disturb`) and contacts are as soft as MuJoCo's default; 0 asks for nothing.
        The others count only then:
      robust_friction: factor of all friction coefficients meanwhile.
      robust_steps: steps of that turn.
      robust_shift, robust_turn: metres in plan and radians that any object may be from where it came to rest.
    """

    timestep: float = 1 / 240
    max_steps: int = 240
    quiet_steps: int = 20
    settle_steps: int = 40
    max_speed: float = 0.005
    max_acceleration: float = 1.0
    max_angular_speed: float = math.radians(0.5)
    max_angular_acceleration: float = math.radians(180)
    per_axis: bool = False
    stop_when_decided: bool = True
    judge_neighbours: bool = True
    max_shift: float = 0.002
    max_turn: float = math.radians(2)
    max_penetration: float = 0.002
    max_added_penetration: float = 0.001
    stand_steps: int = 60
    stand_shift: float = 0.0001
    stand_turn: float = math.radians(0.1)
    stand_full_steps: int = 480
    stand_full_shift: float = 0.005
    stand_full_turn: float = math.radians(5)
    both_detectors: bool = False
    decide_alone: bool = False
    side_support: bool = False
    lower_releases: bool = False
    robust_tilt: float = 0.0
    robust_friction: float = 0.7
    robust_steps: int = 120
    robust_shift: float = 0.002
    robust_turn: float = math.radians(2)

    def __post_init__(self) -> None:
        others = {"per_axis", *_DECIDED} - {"timestep"}
        check_positive(self, *(f.name for f in fields(self) if f.name not in others))
        if not (isinstance(self.robust_tilt, Real) and 0 <= self.robust_tilt < math.pi / 2):
            raise ConfigError(
                f"StabilityConfig.robust_tilt = {self.robust_tilt!r}",
                "radians from 0 to a right angle",
                f"{ROBUST_TILT:.4f}, which is {math.degrees(ROBUST_TILT):g} degrees, or 0 to ask for nothing",
            )
        if self.decision_step > self.max_steps:
            raise ConfigError(
                f"settle_steps + quiet_steps = {self.decision_step} with max_steps = {self.max_steps}",
                "at most max_steps",
                "raising max_steps",
            )

    @classmethod
    def standing_within(cls, max_shift: float, max_turn_deg: float) -> StabilityConfig:
        """With these limits of a finished scene, metres and degrees."""
        return cls(stand_full_shift=max_shift, stand_full_turn=math.radians(max_turn_deg))

    @property
    def file_margin(self) -> float:
        """Metres at which contacts of saved scenes begin; 0 but for robust ones (`ROBUST_MARGIN`)."""
        return ROBUST_MARGIN if self.robust_tilt and self.both_detectors else 0.0

    @property
    def file_timestep(self) -> float:
        """Seconds of a step in files that choose libccd: half of what scenes are made with.

        libccd names few contact points. With steps of 1/240 s flat, light things rock on them, now and then
        and ever more: of 499 scenes of thirty objects 6 fell in MuJoCo 3.10, most after some seconds.
        """
        return self.timestep / 2 if self.both_detectors else self.timestep

    @property
    def decision_step(self) -> int:
        """The last step at which an attempt can become stable."""
        return self.settle_steps + self.quiet_steps

    @property
    def last_step(self) -> int:
        """The step at which an attempt ends at the latest."""
        return self.decision_step if self.stop_when_decided else self.max_steps


def stability_record(config: StabilityConfig) -> Record:
    """The config as records keep it: without what older versions did not know, where that is off."""
    record = asdict(config)
    for name in ("both_detectors", "decide_alone", "side_support", "lower_releases"):
        if not record[name]:
            del record[name]
    if config.robust_tilt:
        return record
    return {name: value for name, value in record.items() if not name.startswith("robust_")}


_DECIDED = (
    "timestep",
    "stop_when_decided",
    "judge_neighbours",
    "both_detectors",
    "decide_alone",
    "side_support",
    "lower_releases",
    "robust_tilt",
)
"""Fields of a `StabilityConfig` that are no limits: engine, contacts, `setting` and rules decide them."""
_STAYS_PUT = {
    "shift": ("max_shift", "stand_shift", "stand_full_shift"),
    "turn": ("max_turn", "stand_turn", "stand_full_turn"),
}
_UNITS = {"mm": 1e-3, "m": 1.0, "deg": math.radians(1), "rad": 1.0}
_STABILITY_EXAMPLE = "stability='shift=0.002,turn=2deg'"


def stability_of(given: object) -> StabilityConfig:
    """Limits of what counts as stable, from text, "shift=0.002,turn=2deg", a mapping, or as they are.

    `shift` and `turn` are how far an object that stands may move in whatever happens to it later: attempts
    for others, the last check, `verify`. Other names are those of numbers of a `StabilityConfig`. Numbers are
    SI units and radians, or have mm, m, deg or rad behind them.

    Raises:
      ConfigError: a name is unknown or comes twice, a value is no number, out of range or not for a user to
        choose, or `quiet_steps` and `settle_steps` do not fit `max_steps`.
    """
    usual = StabilityConfig()
    if isinstance(given, StabilityConfig):
        if fixed := [name for name in _DECIDED if getattr(given, name) != getattr(usual, name)]:
            raise _no_choice_of(fixed[0])
        return given
    pairs: list[tuple[str, object]] = []
    if isinstance(given, str):
        for part in filter(None, (each.strip() for each in given.split(","))):
            named, equals, text = part.partition("=")
            if not equals:
                raise ConfigError(
                    f"stability {part!r}", "NAME=VALUE, with commas between", _STABILITY_EXAMPLE
                )
            pairs.append((named.strip(), text.strip()))
    elif isinstance(given, Mapping):
        pairs = list(given.items())
    if not pairs:
        raise ConfigError(
            f"stability = {given!r}",
            "text, a mapping of names to numbers, or a StabilityConfig",
            _STABILITY_EXAMPLE,
        )
    allowed = (*_STAYS_PUT, *(each.name for each in fields(usual) if each.name not in _DECIDED))
    found: dict[str, float] = {}
    for name, value in pairs:
        if name in _DECIDED:
            raise _no_choice_of(name)
        if name not in allowed:
            raise ConfigError(
                f"stability {name!r}",
                ", ".join(allowed),
                _STABILITY_EXAMPLE,
                closest(name, allowed),
            )
        if name in found:
            raise ConfigError(f"stability {given!r}, where {name} comes twice", "every name once")
        found[name] = _limit(name, value)
    changes: dict[str, Any] = {}
    for name, places in _STAYS_PUT.items():
        if name in found:
            limit = found.pop(name)
            changes |= dict.fromkeys(places, limit)
            # What moved less in the first stage of the last check stands already.
            changes[places[1]] = min(limit, getattr(usual, places[1]))
    changes |= found
    for name, value in changes.items():
        # Steps are counted.
        if isinstance(getattr(usual, name), int) and value == int(value):
            changes[name] = type(getattr(usual, name))(value)
    check_whole(**{name: changes[name] for name in changes if name.endswith("_steps")})
    return replace(usual, **changes)


def _no_choice_of(name: str) -> ConfigError:
    return ConfigError(
        f"stability with another {name}",
        "limits; engine, contacts, `setting` and `robust` decide this",
        "robust=True" if name == "robust_tilt" else _STABILITY_EXAMPLE,
    )


def _limit(name: str, value: object) -> float:
    """A number, or text of one with its unit; it is a length, an angle or a number of steps."""
    factor = 1.0
    given = value
    if isinstance(value, str):
        text = value
        for unit, size in _UNITS.items():
            if text.endswith(unit):
                factor = size
                text = text.removesuffix(unit)
                break
        try:
            value = float(text)
        except ValueError:
            value = None
    if not isinstance(value, Real) or not math.isfinite(value):
        raise ConfigError(
            f"stability {name}={given!r}",
            f"a number, with {', '.join(_UNITS)} behind it if wanted",
            _STABILITY_EXAMPLE,
        )
    return float(value) * factor


def stability_text(config: StabilityConfig) -> str:
    """The limits that are not the usual ones, as `stability_of` reads them; "" if all are."""
    usual = asdict(StabilityConfig())
    given = asdict(config)
    changed = {name: value for name, value in given.items() if value != usual[name]}
    words = []
    for name, places in _STAYS_PUT.items():
        limit = given[places[0]]
        alike = (limit, min(limit, usual[places[1]]), limit)
        if changed.keys() & {*places} and tuple(given[place] for place in places) == alike:
            words.append(f"{name}={_limit_text(name, limit)}")
            for place in places:
                changed.pop(place, None)
    words += [
        f"{name}={_limit_text(name, value)}"
        for name, value in changed.items()
        if name not in _DECIDED
    ]
    return ",".join(words)


def _limit_text(name: str, value: float) -> str:
    """A limit as text that is read as the same number, angles in degrees where they can be."""
    degrees = f"{math.degrees(value):.6g}deg"
    is_angle = "turn" in name or "angular" in name
    return degrees if is_angle and _limit(name, degrees) == value else repr(value + 0)


@dataclass(frozen=True)
class ContactConfig:
    """Contact and solver parameters, the same in every engine and in every exported file.

    There is no joint damping: it cannot be exported and hides creep.
    `studies/benchmarks/contact.py` is the evidence.

    Attributes:
      friction: sliding, torsional and rolling coefficients (MuJoCo's order).
      solref: time constant in seconds and damping ratio; the fastest that the time step allows is 2 dt.
      solimp: MuJoCo's impedance: d0, dmax, width, midpoint, power. Firmer than MuJoCo's (0.9, 0.95): a tenth
        of the overlap, a thirtieth of the creep, and float32 comes to rest as float64 does.
      condim: dimensions of a contact; 4 adds torsional friction.
      cone: "elliptic" or "pyramidal".
      impratio: ratio of frictional to normal impedance.
      iterations: solver iterations at most.
      noslip_iterations: no-slip iterations (native only; MJX has none).
      gravity: m/s^2, downwards.
    """

    friction: tuple[float, float, float] = (0.5, 0.005, 0.0001)
    solref: tuple[float, float] = (2 / 240, 1.0)
    solimp: tuple[float, float, float, float, float] = (0.99, 0.999, 0.001, 0.5, 2.0)
    condim: int = 4
    cone: str = "elliptic"
    impratio: float = 1.0
    iterations: int = 100
    noslip_iterations: int = 0
    gravity: float = 9.81

    def __post_init__(self) -> None:
        check_positive(self, "impratio", "iterations", "gravity")
        for name, length in (("friction", 3), ("solref", 2), ("solimp", 5)):
            value = getattr(self, name)
            if not (
                isinstance(value, tuple) and len(value) == length and all(map(_is_positive, value))
            ):
                allowed = f"a tuple of {length} finite numbers above zero"
                raise ConfigError(f"ContactConfig.{name} = {value!r}", allowed)
        for name, choices in (("condim", (1, 3, 4, 6)), ("cone", ("elliptic", "pyramidal"))):
            if (value := getattr(self, name)) not in choices:
                raise ConfigError(f"ContactConfig.{name} = {value!r}", ", ".join(map(str, choices)))
        if self.noslip_iterations != 0:
            check_positive(self, "noslip_iterations")


MAX_SECONDS = 3600.0
"""Of the simulation of one scene, in checks and certificates."""


def check_seconds(argument: str, seconds: object) -> None:
    """Refuses a time for which no scene is simulated (ConfigError)."""
    if not (_is_positive(seconds) and float(seconds) <= MAX_SECONDS):  # type: ignore[arg-type]
        raise ConfigError(
            f"{argument} = {seconds!r}",
            f"a finite number above zero, {MAX_SECONDS:g} at most",
            "leaving seconds at its default",
        )


@dataclass(frozen=True)
class VerifyConfig:
    """What it takes to stand in the independent check of saved files (docs/contract.md).

    Attributes:
      seconds: how long the scene is simulated, 3600 at most.
      max_shift: metres any object may be from its start at any time. At its default, a bank that was asked
        for another limit (`stability`) is judged by that one.
      max_turn_deg: degrees any object may have turned; likewise.
    """

    seconds: float = 10.0
    max_shift: float = StabilityConfig.stand_full_shift
    max_turn_deg: float = math.degrees(StabilityConfig.stand_full_turn)

    def __post_init__(self) -> None:
        check_positive(self, "max_shift", "max_turn_deg")
        check_seconds("VerifyConfig.seconds", self.seconds)

    @property
    def limits(self) -> StabilityConfig:
        """The same limits as `physics.standing` takes them."""
        return StabilityConfig.standing_within(self.max_shift, self.max_turn_deg)
