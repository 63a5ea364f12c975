"""What may stand where: kinds of things, what they are usually on, in and beside, and how they are left.

The table is data: `scene_sense.yaml` beside this file says what its fields mean; a user's own replaces it.
An object's kind follows from its synset, else from its label, else from its name, by the table's words and
by WordNet's hypernyms (`assets.nouns`). What has no kind is free: nothing is known of where it belongs.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Literal, Protocol, get_args

import msgspec
import numpy as np

from cluttergen_jax.assets.nouns import SYNSET, Nouns, read_nouns
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import ConfigError, closest, first_names
from cluttergen_jax.schema import SchemaError, convert, digest_of, parse_yaml, read_written

FORMAT = 1
FREE = ""
"""The kind of what has none."""
SENSE_FILE = Path(__file__).with_name("scene_sense.yaml")
Turn = Literal["free", "edge", "along", "towards", "front"]
TURNS: tuple[str, ...] = get_args(Turn)
"""How things are turned; the numbers of `SenseArrays.turn` are places in it."""
Stands = Literal["any", "upright", "lying"]
STANDS: tuple[str, ...] = get_args(Stands)
Zone = Literal["", "front", "back"]

USUAL = 3.0
UNUSUAL = 0.001
"""Weights of what is usual and of what is not; 1 where it is not known, as of what is free."""

_BOX_SHARE = 0.88
"""Of the box around it in plan: what fills as much, seen from above, is box-like (a circle fills 0.79)."""
_LONG = 2.5
_MOST_NAMED = 8
_LONGEST_PHRASE = 4
_TAIL = re.compile(r"\b(?:with|in|on|for|and|from)\b|[(,;:]")
"""What follows in a label says more of the thing, not what it is."""


class ThingKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A kind of thing; see scene_sense.yaml for what each field means."""

    synsets: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    on_top_of: tuple[str, ...] = ()
    inside: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    carries: Literal["never", "alike", "some"] = "some"
    turn: Turn | None = None
    stands: Stands = "any"
    zone: Zone = ""
    table: bool = True


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    format: int
    kinds: dict[str, ThingKind]
    groups: dict[str, tuple[str, ...]] = {}
    themes: dict[str, tuple[str, ...]] = {}
    ignore: tuple[str, ...] = ()


class Named(Protocol):
    """Anything with an object's words: an `ObjectAsset`, or its `ObjectFacts`."""

    @property
    def name(self) -> str: ...
    @property
    def label(self) -> str: ...
    @property
    def synset(self) -> str: ...


@dataclass(frozen=True, eq=False)
class SenseArrays:
    """What a table of sense says of K objects.

    Attributes:
      kinds: of each; "" for one that is free.
      weight_on, weight_in, weight_beside: f32[K, K], row: an object, column: what carries, holds or
        neighbours it: `USUAL`, 1 where one of the two is free, else `UNUSUAL`; of neighbours `USUAL` or 1.
      never_carries: bool[K, K], the same: the column carries nothing, and the row is not usual in it.
      turn: i32[K], places in `TURNS`; those without are decided by shape.
      stands: i32[K], places in `STANDS`.
      zone: f32[K], 1 at the front of the table, -1 at the back, 0 anywhere.
      on_table: bool[K], False for what does not belong on a table.
      heading: f32[K], radians, of its longer side in plan, object frame; 0 where its shape shows none.
    """

    kinds: tuple[str, ...]
    weight_on: np.ndarray
    weight_in: np.ndarray
    weight_beside: np.ndarray
    never_carries: np.ndarray
    turn: np.ndarray
    stands: np.ndarray
    zone: np.ndarray
    on_table: np.ndarray
    heading: np.ndarray

    @property
    def is_free(self) -> np.ndarray:
        """bool[K], those without a kind."""
        return np.array([kind == FREE for kind in self.kinds])


@dataclass(frozen=True, eq=False)
class SceneSense:
    """A table of sense, read and checked.

    Attributes:
      kinds: by name; groups: of kinds, by name; themes: the kinds of each.
      ignore: words of labels that name no thing.
      digest: hex SHA-256 of the file.
    """

    kinds: dict[str, ThingKind]
    groups: dict[str, frozenset[str]]
    themes: dict[str, frozenset[str]]
    ignore: frozenset[str]
    digest: str
    _known: dict[tuple[str, str, str], str] = field(default_factory=dict, repr=False)

    @cached_property
    def _kind_of_synset(self) -> dict[str, str]:
        return {synset: name for name, kind in self.kinds.items() for synset in kind.synsets}

    @cached_property
    def _kind_of_word(self) -> dict[str, str]:
        return {word.lower(): name for name, kind in self.kinds.items() for word in kind.words}

    def kind_of(self, each: Named) -> str:
        """The kind of an object by its synset, else its label, else its name; `FREE` if none says it."""
        key = (each.synset, each.label, each.name)
        if key not in self._known:
            texts = (text for text in key if text)
            found = (self._kind_of_text(text) for text in texts)
            self._known[key] = next(filter(None, found), FREE)
        return self._known[key]

    def is_usual(self, relation: Literal["on", "in", "beside"], lower: str, upper: str) -> bool:
        """Whether a thing of kind `upper` is usually on, in or beside one of kind `lower`."""
        return lower in self._usual(relation, upper)

    def carries_its_like(self, kind: str) -> bool:
        """Whether people stack things of a kind; True of what has none."""
        carries = self.kinds.get(kind, ThingKind()).carries
        return carries != "never" or any(self.is_usual(how, kind, kind) for how in ("on", "in"))

    def members(self, names: Iterable[str]) -> frozenset[str]:
        """The kinds that names of kinds and groups mean."""
        return frozenset().union(*(self.groups.get(name, {name}) for name in names))

    def _usual(self, relation: str, kind: str) -> frozenset[str]:
        if kind not in self.kinds:
            return frozenset()
        return self.members(getattr(self.kinds[kind], _FIELDS[relation]))

    def _kind_of_text(self, text: str) -> str:
        if SYNSET.fullmatch(text.lower()):
            return self._kind_of_noun(text.lower(), read_nouns())[1]
        # CamelCase and figures part words, as in AlarmClock and 030_fork.
        text = re.sub(r"(?<=[a-z]{2})(?=[A-Z])", " ", text).lower()
        text = re.sub(r"[_\-/\d.]+", " ", text)
        head = _TAIL.split(" " + text)[0].strip() or text
        words = [word for word in head.split() if word not in self.ignore]
        # What a thing is called stands last; before it stand more words on it.
        for end in range(len(words), 0, -1):
            for start in range(max(0, end - _LONGEST_PHRASE), end):
                if found := self._kind_of_phrase(" ".join(words[start:end])):
                    return found
        return FREE

    def _kind_of_phrase(self, phrase: str) -> str:
        nouns = read_nouns()
        for word in (phrase, *_singulars(phrase)):
            if found := self._kind_of_word.get(word):
                return found
            senses = [self._kind_of_noun(each, nouns) for each in nouns.senses.get(word, ())]
            # The sense that is nearest to what the table names; the most frequent one of equals.
            if near := [each for each in senses if each[1]]:
                return min(near, key=lambda each: min(each[0], _NEAR))[1]
        return FREE

    def _kind_of_noun(self, synset: str, nouns: Nouns) -> tuple[int, str]:
        """How many synsets up the kind of a synset is found, and the kind; `FREE` if there is none."""
        above = nouns.hypernyms(synset)
        found = ((place, self._kind_of_synset.get(each)) for place, each in enumerate(above))
        return next(((place, kind) for place, kind in found if kind), (len(above), FREE))

    def in_theme(self, theme: str, facts: Sequence[Named], pool: str) -> tuple[str, ...]:
        """Names of the objects that belong to a theme.

        Raises:
          ConfigError: there is no such theme, or none of the objects belongs to it.
        """
        if theme not in self.themes:
            known = ", ".join(self.themes)
            hint = f"theme={next(iter(self.themes), '')!r}"
            raise ConfigError(f"theme = {theme!r}", known, hint, closest(theme, self.themes))
        kinds = [self.kind_of(each) for each in facts]
        found = tuple(
            each.name for each, kind in zip(facts, kinds, strict=True) if kind in self.themes[theme]
        )
        if not found:
            served = [name for name, its in self.themes.items() if its & {*kinds}]
            raise ConfigError(
                f"theme {theme!r}, to which no object of pool {pool!r} belongs",
                ", ".join(served) or "no theme: the objects of this pool have none",
                f"theme={served[0]!r}" if served else "objects with labels, or no `theme`",
            )
        return found

    def arrays(self, objects: Sequence[ObjectAsset]) -> SenseArrays:
        """What the table says of K objects."""
        kinds = tuple(map(self.kind_of, objects))
        free = np.array([kind == FREE for kind in kinds])
        is_free = free[:, None] | free
        found = {}
        for relation in ("on", "in", "beside"):
            usual = [self._usual(relation, kind) for kind in kinds]
            found[relation] = np.array([[lower in its for lower in kinds] for its in usual])
        usual = found["on"] | found["in"]
        never = np.array(
            [kind in self.kinds and self.kinds[kind].carries != "some" for kind in kinds]
        )
        each = [self.kinds.get(kind, ThingKind()) for kind in kinds]
        shapes = [_plan_of(asset) for asset in objects]
        by_shape = ["edge" if shape.shows_turn else "free" for shape in shapes]
        turns = [one.turn or other for one, other in zip(each, by_shape, strict=True)]
        zones = {"": 0.0, "front": 1.0, "back": -1.0}
        beside = found["beside"] | found["beside"].T
        weights = {
            relation: np.where(is_free, 1.0, np.where(found[relation], USUAL, UNUSUAL))
            for relation in ("on", "in")
        }
        return SenseArrays(
            kinds=kinds,
            weight_on=weights["on"].astype(np.float32),
            weight_in=weights["in"].astype(np.float32),
            weight_beside=np.where(beside, USUAL, 1.0).astype(np.float32),
            never_carries=never[None, :] & ~usual,
            turn=np.array([TURNS.index(turn) for turn in turns], np.int32),
            stands=np.array([STANDS.index(one.stands) for one in each], np.int32),
            zone=np.array([zones[one.zone] for one in each], np.float32),
            on_table=np.array([one.table for one in each]),
            heading=np.array([shape.shown_heading for shape in shapes], np.float32),
        )


_FIELDS = {"on": "on_top_of", "in": "inside", "beside": "beside"}
_NEAR = 8
"""Of senses that are so many synsets from what the table names the more frequent one is taken."""


def sense_of(objects: Sequence[ObjectAsset], path: str | Path = "") -> SenseArrays:
    """What a table of sense says of objects.

    Args:
      path: the file of one's own table; the package's if empty.
    """
    return read_sense(path).arrays(objects)


def read_sense(path: str | Path = "") -> SceneSense:
    """A table of sense.

    Args:
      path: a YAML file like scene_sense.yaml; the package's own if empty.

    Raises:
      ConfigError: there is no such file, it is not as it should be, or a name in it means no kind.
    """
    file = Path(path) if str(path) else SENSE_FILE
    try:
        data = read_written(file)
    except (OSError, SchemaError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"sense = {str(path)!r}: {reason}", "a YAML file", _HINT) from error
    return _parse_sense(data, str(file))


_HINT = "a copy of cluttergen_jax/assets/scene_sense.yaml, changed"


@lru_cache(maxsize=8)
def _parse_sense(data: bytes, file: str) -> SceneSense:
    where = f"sense {file}"
    try:
        raw = parse_yaml(data)
        if not isinstance(raw, dict):
            given = f"{where}: it is no mapping of names to values"
            raise ConfigError(given, "format, kinds, groups, themes, ignore", _HINT)
        content = convert(raw, _File)
    except SchemaError as error:
        fields = ", ".join(each.encode_name for each in msgspec.structs.fields(ThingKind))
        raise ConfigError(f"{where}: {error}", f"of each kind {fields}", _HINT) from error
    if content.format != FORMAT:
        raise ConfigError(f"{where}: format {content.format}", f"format: {FORMAT}", _HINT)
    if not content.kinds:
        raise ConfigError(f"{where}: no kinds", "one kind or more", _HINT)
    kinds = content.kinds
    both = sorted({*kinds} & {*content.groups})
    if both:
        raise ConfigError(f"{where}: {both[0]!r} is a kind and a group", "one of the two", _HINT)
    for field_name in ("synsets", "words"):
        owner_of = [
            (text.lower(), name)
            for name, kind in kinds.items()
            for text in getattr(kind, field_name)
        ]
        counts = Counter(text for text, _ in owner_of)
        twice = [text for text, number in counts.items() if number > 1]
        if twice:
            owners = [name for text, name in owner_of if text == twice[0]]
            given = f"{where}: {twice[0]!r} among the {field_name} of {', '.join(owners)}"
            raise ConfigError(given, "each in one kind, once", _HINT)
    malformed = [
        each for kind in kinds.values() for each in kind.synsets if not SYNSET.fullmatch(each)
    ]
    if malformed:
        given = f"{where}: synset {malformed[0]!r}"
        raise ConfigError(given, "a noun of WordNet 3.0, word.n.number", "plate.n.04")
    lists = {
        f"kind {name!r}": (*kind.on_top_of, *kind.inside, *kind.beside)
        for name, kind in kinds.items()
    }
    lists |= {f"theme {name!r}": members for name, members in content.themes.items()}
    for owner, names in lists.items():
        _check_names(where, owner, names, (*kinds, *content.groups))
    for name, members in content.groups.items():
        _check_names(where, f"group {name!r}", members, tuple(kinds))
    groups = {name: frozenset(members) for name, members in content.groups.items()}
    found = SceneSense(kinds, groups, {}, frozenset(content.ignore), digest_of(data))
    themes = {name: found.members(members) for name, members in content.themes.items()}
    return SceneSense(kinds, groups, themes, found.ignore, found.digest)


def _check_names(where: str, owner: str, names: Iterable[str], known: tuple[str, ...]) -> None:
    for name in names:
        if name not in known:
            given = f"{where}: {name!r} in {owner}, which is no kind or group"
            raise ConfigError(given, first_names(known, _MOST_NAMED), _HINT, closest(name, known))


def _singulars(phrase: str) -> list[str]:
    """What a plural may be the plural of."""
    endings = (("ies", "y"), ("es", ""), ("s", ""))
    return [phrase[: -len(end)] + one for end, one in endings if phrase.endswith(end)]


@dataclass(frozen=True)
class PlanShape:
    """What something is like, seen from above.

    Attributes:
      heading: radians, of the longer side of the smallest rectangle around it.
      sides: metres, of that rectangle, the longer one first.
      fill: the share of the rectangle that its convex hull fills.
    """

    heading: float
    sides: tuple[float, float]
    fill: float

    @property
    def is_box_like(self) -> bool:
        """Whether its sides show how it is turned, as those of what is round do not."""
        return self.fill >= _BOX_SHARE

    @property
    def shows_turn(self) -> bool:
        """Whether it is box-like, or far longer than it is wide."""
        return self.is_box_like or self.sides[0] > _LONG * self.sides[1]

    @property
    def shown_heading(self) -> float:
        """`heading`, or 0 where the shape shows none."""
        return self.heading if self.shows_turn else 0.0


def plan_shape(points: np.ndarray) -> PlanShape:
    """The shape in plan of points f64[N, 2 or 3], metres, z up."""
    from scipy.spatial import ConvexHull, QhullError
    from trimesh.bounds import oriented_bounds_2D

    xy = np.asarray(points, float)[:, :2]
    try:
        area = ConvexHull(xy).volume
        to_box, extents = oriented_bounds_2D(xy)
    except QhullError:
        # All on one line.
        return PlanShape(0.0, (1.0, 1.0), 0.0)
    longer = int(extents[1] > extents[0])
    x, y = to_box[longer, :2]
    sides = (float(extents[longer]), float(extents[1 - longer]))
    return PlanShape(float(np.arctan2(y, x)), sides, float(area / np.prod(extents)))


@cache
def _plan_of(asset: ObjectAsset) -> PlanShape:
    return plan_shape(asset.vertices)
