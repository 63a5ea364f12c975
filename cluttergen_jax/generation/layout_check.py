"""Layouts as people and language models write them: their fields, the JSON schema of these, what is wrong.

A layout is YAML (JSON is YAML, too); `layouts.read_layout` makes a request of one without faults.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

import msgspec
import numpy as np
from msgspec import Meta

from cluttergen_jax.assets import ObjectAsset, find_support
from cluttergen_jax.assets.facts import ObjectFacts, parse_condition
from cluttergen_jax.assets.pool import ALL, Pool, find_pool, list_pools
from cluttergen_jax.assets.sense import read_sense
from cluttergen_jax.config import Poses
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest, first_names
from cluttergen_jax.learning.methods import DEFAULT_METHOD
from cluttergen_jax.placement.arrangements import Arrangement, parse_arrangements
from cluttergen_jax.placement.clutter import NAMES, Clutter
from cluttergen_jax.placement.config import MAX_SLOTS
from cluttergen_jax.placement.problem import check_objects
from cluttergen_jax.placement.related import relate_objects
from cluttergen_jax.placement.relations import (
    KINDS,
    MOST_GAP,
    MOST_RELATIONS,
    TABLE,
    USUAL,
    Relation,
    conditions_of,
    order_of,
    parse_roles,
)
from cluttergen_jax.placement.room import area_asked, crowding
from cluttergen_jax.schema import SchemaError, convert, parse_json, parse_yaml
from cluttergen_jax.spec import MOST_ON_SHELF, SceneSpec

_NAMES_SHOWN = 40
_SHORT = 80
_DISTANT = "|".join(USUAL)
_CLOSE = "|".join((*(kind for kind in KINDS if kind not in (*USUAL, "aligned")), "under"))
_OTHER = rf"(?!{TABLE}(?:[\s:]|$))[^\s:]+"
_GAP = r"(?=[0-9.]*[1-9])(?:[01]?(?:\.[0-9]*)?|2(?:\.0*)?)"
_RELATION = (
    rf"^(?!\s*(\S+)\s+\w+\s+\1\s*(?::|$))\s*(?!{TABLE}\s)[^\s:]+\s+(?:aligned\s+[^\s:]+|"
    rf"(?:{_CLOSE})\s+{_OTHER}|(?:{_DISTANT})\s+{_OTHER}\s*(?::\s*{_GAP})?)\s*$"
)
"""A relation as a pattern of a JSON schema; `Relation.parse` says what is wrong with one."""


_UNREAD = "\0"
"""Stands for a relation that is no text, so that others keep their places."""


class Asked(msgspec.Struct, forbid_unknown_fields=True):
    """Who wrote a layout.

    Attributes:
      request: the sentence.
      model: what the model is called.
      tries: answers until one was right.
    """

    request: str
    model: str
    tries: Annotated[int, Meta(ge=1)]


def _about(text: str, **more: Any) -> Any:
    return Meta(description=text, **more)


class LayoutFields(msgspec.Struct, forbid_unknown_fields=True):
    """A layout as its file has it; the descriptions are those of its schema."""

    objects: Annotated[
        dict[
            Annotated[str, Meta(pattern=rf"^(?!{TABLE}$)[a-z0-9_-]+$")],
            Annotated[str, Meta(min_length=1)],
        ],
        _about(
            "The objects that stand in every scene: names of your own (a-z, 0-9, _ and -), each with the "
            "object of the pool that it is: its name, such as mug; or a pattern of names (mug*); or a "
            "condition (label=*book* and height<0.1). Several of a kind have a name each: "
            "{my_mug: mug, your_mug: mug}.",
            examples=[{"mine": "dinner_plate", "yours": "dinner_plate", "milk": "bottle"}],
        ),
    ]
    relations: Annotated[
        list[Annotated[str, Meta(extra_json_schema={"pattern": _RELATION})]],
        _about(
            "What must hold in every scene, each 'SUBJECT KIND REFERENCE' or 'SUBJECT KIND REFERENCE:GAP', "
            "of names in `objects`. Kinds without a gap: on, under, in (inside of a hollow object), aligned "
            "(longest sides parallel; 'NAME aligned table' to the table's sides). Kinds with a gap in m, "
            f"above 0 and up to {MOST_GAP:g}, in plan: next_to, left_of, right_of, in_front_of, "
            "behind (the gap is at most so much), far_from (at least). Left, right, front and back are "
            "seen by a person who sits at the front of the table; each holds within 45 degrees, so that an "
            "object is on one side of another only. Say each relation once; no circles.",
            max_length=MOST_RELATIONS,
            examples=[["mug next_to plate:0.05", "fork left_of plate", "apple in bowl"]],
        ),
    ] = []
    arrangements: Annotated[
        list[str],
        _about(
            "What is made of equal things besides, each 'KIND CONDITION:NUMBER': row (upright, side by side, "
            "as books), stack (one upon the other), nest (one inside of the other). The condition is of "
            "objects of the pool, as in `objects`.",
            examples=[["row label=*book*:4", "stack dinner_plate:3", "nest bowl:2"]],
        ),
    ] = []
    title: Annotated[str, _about("What people call it.", examples=["Breakfast for two"])] = ""
    pool: Annotated[
        str,
        _about(
            "The pool that the objects are from; several are joined by +.",
            examples=["dining+kitchen"],
        ),
    ] = str(SceneSpec.pool)
    support: Annotated[
        str,
        _about(
            "What the objects stand on: a support's name, or table-WIDTHxDEPTH in metres.",
            examples=["table-1.20x0.70"],
        ),
    ] = str(SceneSpec.support)
    region: Annotated[
        str | None,
        _about(
            "The part of the support that is used, WIDTHxDEPTH in metres about its centre; all if null.",
            examples=["0.40x0.50"],
        ),
    ] = None
    others: Annotated[
        int,
        _about(
            "How many further objects stand anywhere besides: any of the pool, fitting or not, unless there "
            "is a `theme`; better name what belongs there in `objects`.",
            ge=0,
        ),
    ] = 0
    theme: Annotated[
        str,
        _about(
            "The occasion to which the `others` belong: breakfast, dinner, desk, cooking, tools, bathroom or "
            "play; any if empty.",
            examples=["breakfast"],
        ),
    ] = ""
    poses: Annotated[
        Poses,
        _about("How objects come to stand: upright; resting, also lying or tipped over; any."),
    ] = "upright"
    clutter: Annotated[
        dict[str, Annotated[float, Meta(ge=0)]],
        _about(
            "What scenes should have on average, for a mess: stack, the number of objects on others; "
            "contained, of objects inside of others; near, the mean gap to the nearest object in metres "
            "(0.02 is crowded). Leave it out for a tidy table.",
            extra_json_schema={"propertyNames": {"enum": list(NAMES)}},
            examples=[{"stack": 2, "near": 0.02}],
        ),
    ] = {}
    crowd: Annotated[
        float,
        _about(
            "How far all is drawn together in the end: 0, it stays apart, as on a laid table; 0.5, things "
            "touch one another, a messy table; 1, a heap.",
            ge=0,
            le=1,
        ),
    ] = 0.0
    natural: Annotated[
        bool,
        _about(
            "Place things as people leave them: what is usually on, in and beside what, turned to the edges "
            "of the table or to the person who sits at its front."
        ),
    ] = False
    asked: Annotated[
        Asked | None,
        _about("Written by `cluttergen layout ask`: leave it out."),
    ] = None


FIELDS = LayoutFields.__struct_fields__
_MEANT = {
    **dict.fromkeys(("items", "roles", "things", "instances"), "objects"),
    **dict.fromkeys(("constraints", "rules"), "relations"),
    **dict.fromkeys(("name", "description", "scene"), "title"),
    **dict.fromkeys(("table", "surface", "furniture"), "support"),
    **dict.fromkeys(("extra", "extras", "num_others", "distractors"), "others"),
    **dict.fromkeys(("occasion", "context"), "theme"),
}


_KIND_MEANT = {
    **dict.fromkeys(("beside", "besides", "near", "by", "close_to", "adjacent_to"), "next_to"),
    **dict.fromkeys(("inside", "into", "within", "inside_of"), "in"),
    **dict.fromkeys(("above", "atop", "upon", "on_top_of", "onto", "over"), "on"),
    **dict.fromkeys(("below", "beneath", "underneath"), "under"),
    **dict.fromkeys(("front_of", "before", "in_front"), "in_front_of"),
    **dict.fromkeys(("behind_of", "in_back_of", "after"), "behind"),
    **dict.fromkeys(("left", "to_the_left_of"), "left_of"),
    **dict.fromkeys(("right", "to_the_right_of"), "right_of"),
    **dict.fromkeys(("away_from", "apart_from", "far"), "far_from"),
    **dict.fromkeys(("parallel_to", "aligned_with", "aligned_to"), "aligned"),
}


def layout_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a layout: what each field means, and what it may be.

    The reader's own fields make it. What a schema cannot say, such as which objects a pool has, is for
    `check_layout`.
    """
    found = msgspec.json.schema(LayoutFields)
    definitions = found["$defs"]
    own = definitions.pop(LayoutFields.__name__)
    own["title"] = "A layout of cluttergen"
    own["description"] = "What shall stand where on a table, in YAML or JSON."
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **own}
    return {**schema, "$defs": definitions}


@dataclass(frozen=True)
class LayoutFault:
    """One thing that is wrong with a layout.

    Attributes:
      path: where in the file: objects.mug, relations[2]; "" for the whole.
      given: what is there; allowed: what may be; hint: what to try; meant: what was probably meant.
    """

    path: str
    given: str
    allowed: str = ""
    hint: str = ""
    meant: str = ""

    @staticmethod
    def of(path: str, error: ClutterGenError) -> LayoutFault:
        """What an error says."""
        return LayoutFault(path, error.given, error.allowed, error.hint, error.meant)

    def __str__(self) -> str:
        text = str(ClutterGenError(self.given, self.allowed, self.hint, self.meant))
        return f"{self.path}: {text}" if self.path else text


class LayoutError(ConfigError):
    """A layout that cannot be a request.

    Attributes:
      faults: all that is wrong with it.
    """

    def __init__(self, name: str, faults: Sequence[LayoutFault]) -> None:
        self.faults = tuple(faults)
        first = self.faults[0]
        where = f" ({first.path})" if first.path else ""
        given = f"{first.given.rstrip('.')} of layout {name!r}{where}"
        super().__init__(given, first.allowed, first.hint, first.meant)
        if len(faults) > 1:
            self.given = f"{len(faults)} errors in layout {name!r}"
            self.args = ("\n".join([f"{self.given}:", *(f"  {each}" for each in faults)]),)


class LayoutCheck(NamedTuple):
    """What is to be said of a layout.

    Attributes:
      faults: why it can be no request; all that were found.
      notes: what may make it hard to fulfil.
      spec: the request that it is; None with faults.
    """

    faults: tuple[LayoutFault, ...]
    notes: tuple[str, ...] = ()
    spec: SceneSpec | None = None

    @property
    def is_sound(self) -> bool:
        """Whether nothing is wrong with it."""
        return not self.faults

    def __str__(self) -> str:
        notes = [f"note: {note}" for note in self.notes]
        if self.spec is None:
            number = len(self.faults)
            head = "1 error" if number == 1 else f"{number} errors"
            return "\n".join([head, *map(str, self.faults), *notes])
        relations = len(self.spec.relations)
        return "\n".join([f"sound: {self.spec.num_objects} objects, {relations} relations", *notes])


def check_text(data: bytes, options: Mapping[str, Any], found: Pool | None = None) -> LayoutCheck:
    """All that is wrong with a layout in YAML or JSON (`cluttergen_jax.layout.check`).

    Args:
      options: fields of `SceneSpec`, in place of what the layout says.
      found: the pool of the options, where it is at hand.
    """
    try:
        content = parse_content(data)
    except SchemaError as error:
        return LayoutCheck((LayoutFault("", str(error), "YAML, or JSON"),))
    layout, faults = read_fields(content)
    pool = str(options.get("pool", layout.pool))
    try:
        found = found or pool_of(pool, options.get("exclude", ()))
    except ClutterGenError as error:
        faults.append(LayoutFault.of("pool", error))
        # What else is wrong is seen by the pool that was meant.
        pool = _pool_meant(pool)
        found = pool_of(pool) if pool else None
    facts = () if found is None else found.facts
    faults += [
        *meaning_faults(layout, facts, pool),
        *_contradictions(layout),
        *_number_faults(layout, len(facts)),
        *(_pool_faults(layout, facts, pool) if facts else ()),
    ]
    support = str(options.get("support", layout.support))
    try:
        find_support(support)
    except ClutterGenError as error:
        faults.append(LayoutFault.of("support", error))
        support = error.meant
    rest = _sound_part(layout, faults)
    is_told = bool({"", "objects"} & {*map(_field_in, faults)})
    if found is None or not support or (is_told and _is_empty(rest)):
        return LayoutCheck(tuple(sorted(faults, key=place_of)))
    request = {**options, "pool": pool, "support": support}
    notes: list[str] = []
    spec = None
    while spec is None:
        try:
            asked = replace(spec_of_layout(rest, found), **request)
            notes = _room_notes(asked, rest, found)
            spec = asked
        except ClutterGenError as error:
            fault = LayoutFault.of(_place_of_error(error, rest), error)
            faults.append(replace(fault, path=_path_before(fault.path, rest, layout)))
            smaller = _sound_part(rest, [fault])
            if smaller == rest or _is_empty(smaller):
                break
            rest = smaller
    if faults:
        return LayoutCheck(tuple(sorted(faults, key=place_of)))
    return LayoutCheck((), tuple(notes), spec)


def _pool_meant(name: str) -> str:
    """A pool's name with each part as it was probably meant; "" where that is not known."""
    known = [*list_pools(), ALL]
    parts = [each if each in known else closest(each, known) for each in name.split("+")]
    return "+".join(dict.fromkeys(parts)) if all(parts) else ""


def _sound_part(layout: LayoutFields, faults: Iterable[LayoutFault]) -> LayoutFields:
    """A layout without what faults are about, so that the rest can be checked."""
    paths = {fault.path for fault in faults}

    def sound_texts(field: str) -> list[str]:
        texts = () if field in paths else getattr(layout, field)
        is_well = [f"{field}[{place}]" not in paths for place in range(len(texts))]
        return [text for text, well in zip(texts, is_well, strict=True) if well]

    given = {} if "objects" in paths else layout.objects
    objects = {name: meant for name, meant in given.items() if f"objects.{name}" not in paths}
    lost = layout.objects.keys() - objects.keys()
    usual = LayoutFields({})
    plain = ("region", "others", "theme", "poses", "crowd", "natural")
    values = {name: getattr(usual, name) for name in plain if name in paths}
    is_odd = any(path.partition(".")[0] == "clutter" for path in paths)
    return msgspec.structs.replace(
        layout,
        objects=objects,
        relations=[
            text
            for text in sound_texts("relations")
            if text != _UNREAD and not lost & {*text.partition(":")[0].split()}
        ],
        arrangements=sound_texts("arrangements"),
        clutter=usual.clutter if is_odd else layout.clutter,
        **values,
    )


def _is_empty(layout: LayoutFields) -> bool:
    """Whether a layout asks for no object."""
    return not (layout.objects or layout.arrangements or layout.others)


def _path_before(path: str, rest: LayoutFields, layout: LayoutFields) -> str:
    """A place in the rest of a layout as a place in the layout."""
    field, bracket, place = path.partition("[")
    if not bracket:
        return path
    text = getattr(rest, field)[int(place.rstrip("]"))]
    return f"{field}[{getattr(layout, field).index(text)}]"


def place_of(fault: LayoutFault) -> int:
    """Where a fault stands among those of other fields."""
    field = _field_in(fault)
    return FIELDS.index(field) if field in FIELDS else len(FIELDS)


def _field_in(fault: LayoutFault) -> str:
    """The field of a layout that a fault is about."""
    return re.split(r"[.\[]", fault.path)[0]


def parse_content(data: bytes) -> Any:
    """What a layout's file says (SchemaError: it is neither JSON nor YAML)."""
    if data.lstrip()[:1] == b"{":
        try:
            return parse_json(data)
        except SchemaError:
            # Flow style, {a: b}, is YAML alone; of broken JSON YAML says the line.
            pass
    return parse_yaml(data)


def read_fields(content: Any) -> tuple[LayoutFields, list[LayoutFault]]:
    """The fields of a layout; those that are of another form are left out, and are faults."""
    if not isinstance(content, dict):
        given = f"{_kind_of(content)} instead of a mapping"
        return LayoutFields({}), [LayoutFault("", given, f"a mapping with {', '.join(FIELDS)}")]
    faults = [
        LayoutFault(
            key,
            f"the key {key!r} is not known",
            ", ".join(FIELDS[:-1]),
            meant=_MEANT.get(key.lower(), "") or closest(key, FIELDS),
        )
        for key in content
        if key not in FIELDS
    ]
    values: dict[str, Any] = {"objects": {}}
    if "objects" not in content:
        faults.append(LayoutFault("objects", "it is missing", "a mapping of names to objects"))
    for field in msgspec.structs.fields(LayoutFields):
        if field.name in content:
            value, found = _read_field(field.name, content[field.name], field.type)
            faults += found
            if value is not None:
                values[field.name] = value
    return convert(values, LayoutFields), faults


def _read_field(name: str, value: Any, kind: Any) -> tuple[Any, list[LayoutFault]]:
    """A field's value, of a mapping or a list the sound entries; and what is wrong with it."""
    faults: list[LayoutFault] = []
    inner = get_origin(get_args(kind)[0]) if get_origin(kind) is Annotated else None
    if inner is dict and isinstance(value, dict):
        parts: Iterable[tuple[str, Any]] = [(f"{name}.{k}", {k: v}) for k, v in value.items()]
    elif inner is list and isinstance(value, list):
        parts = [(f"{name}[{place}]", [v]) for place, v in enumerate(value)]
    else:
        parts = [(name, value)]
    sound: list[Any] = []
    for path, part in parts:
        try:
            sound.append(msgspec.convert(part, kind))
        except (msgspec.ValidationError, RecursionError) as error:
            fault = _fault_of_type(path, part, str(error))
            if choices := _choices(kind):
                fault = replace(
                    fault, allowed=", ".join(choices), meant=closest(str(value), choices)
                )
            faults.append(fault)
            if inner is list:
                sound.append([_UNREAD])
    if inner is dict:
        return {k: v for part in sound for k, v in part.items()}, faults
    if inner is list:
        items = [each for part in sound for each in part]
        if len(items) > MOST_RELATIONS:
            faults.append(LayoutFault(name, f"{len(items)} of them", f"up to {MOST_RELATIONS}"))
            items = items[:MOST_RELATIONS]
        return items, faults
    return (sound[0] if sound else None), faults


def _choices(kind: Any) -> tuple[str, ...]:
    """The words that a field may be; none where it may be any."""
    inner = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    return get_args(inner) if get_origin(inner) is Literal else ()


def _fault_of_type(path: str, part: Any, said: str) -> LayoutFault:
    """A fault of a value's type or range, from what msgspec says of it."""
    if isinstance(part, dict) and path.startswith(("objects.", "clutter.")):
        ((key, value),) = part.items()
        if path.startswith("objects.") and isinstance(value, str) and value:
            return LayoutFault(
                path,
                f"the name {key!r}",
                f"names of a-z, 0-9, _ and -, other than {TABLE!r}",
                f"{plain_name(key)}, here and in `relations`",
            )
        part = value
    elif isinstance(part, list) and len(part) == 1:
        part = part[0]
    allowed = re.sub(r" - at .*$|, got `.*?`|Expected |`", "", said)
    allowed = re.sub(r"^\w+", lambda found: _KINDS.get(found[0], found[0]), allowed)
    hint = ""
    if path == "objects":
        hint = "objects: {my_mug: mug, plate: dinner_plate}"
    elif allowed == "text" and not isinstance(part, str):
        hint = "quotes around it" if not isinstance(part, dict | list) else "one text"
    return LayoutFault(path, _short(part), allowed, hint)


_KINDS = {"str": "text", "object": "a mapping", "array": "a list", "bool": "true or false"}
_KINDS |= {"int": "a whole number", "float": "a number"}


def plain_name(text: str) -> str:
    """A name of a layout that is like a text."""
    found = re.sub(r"[^a-z0-9_-]+", "_", str(text).lower()).strip("_")
    return found if found and found != TABLE else "thing"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}..."


def _kind_of(value: Any) -> str:
    kinds: dict[type, str] = {list: "a list", str: "text", type(None): "nothing"}
    return kinds.get(type(value), type(value).__name__)


def pool_of(name: str, exclude: Sequence[str] = ()) -> Pool:
    """A pool without what is excluded (PoolError: there is none)."""
    return find_pool(SceneSpec(pool=name, exclude=exclude).pool_text)


def meaning_faults(
    layout: LayoutFields, facts: Sequence[ObjectFacts] | None = None, pool: str = ""
) -> Iterator[LayoutFault]:
    """What names, conditions and relations say that cannot be.

    Args:
      facts: of the pool's objects; looked up where they are needed if None, not known if empty.
      pool: its name, the layout's own if "".
    """
    pool = pool or layout.pool
    for name, condition in layout.objects.items():
        try:
            parse_roles({name: condition})
        except ConfigError as error:
            fault = LayoutFault.of(f"objects.{name}", error)
            # Words without a sign are what people call it.
            is_label = re.fullmatch(r"[^<>=]+", condition) is not None
            if facts and is_label and (meant := name_meant(condition, facts)):
                fault = _no_such_object(name, condition, facts, pool, meant)
            yield fault
    for place, text in enumerate(layout.arrangements):
        try:
            Arrangement.parse(text)
        except ConfigError as error:
            yield LayoutFault.of(f"arrangements[{place}]", error)
    relations: list[Relation] = []
    for place, text in enumerate(layout.relations):
        path = f"relations[{place}]"
        if text == _UNREAD:
            continue
        try:
            relation = Relation.parse(text)
        except ConfigError as error:
            fault = LayoutFault.of(path, error)
            yield replace(fault, meant=_relation_meant(text) or fault.meant)
            continue
        relations.append(relation)
        for name in dict.fromkeys((relation.subject, relation.reference)):
            if name in (*layout.objects, TABLE, "any"):
                continue
            if facts is None:
                facts = pool_of(pool).facts
            known = [each.name for each in facts]
            if name not in known:
                own = f"{', '.join(layout.objects)}, or " if layout.objects else ""
                yield LayoutFault(
                    path,
                    f"{name!r} in a relation",
                    f"{own}an object of pool {pool!r}: {first_names(known, _NAMES_SHOWN)}"
                    if known
                    else f"{own}an object of the pool, which is not known",
                    meant=closest(name, [*layout.objects, *known]),
                )
    try:
        order_of(relations)
    except ConfigError as error:
        hint = "leaving one of them out; 'a left_of b' says 'b right_of a' as well"
        yield LayoutFault("relations", error.given, error.allowed, hint)


def _relation_meant(text: str) -> str:
    """The relation that was probably meant, as "cup next_to plate" of "cup next to plate"; "" if none."""
    body, colon, gap = text.partition(":")
    subject, *middle, reference = [*body.split(), "", ""][: max(len(body.split()), 2)]
    words = "_".join(middle).lower().replace("is_", "")
    kind = words if words in KINDS else _KIND_MEANT.get(words, "")
    meant = f"{subject} {kind} {reference}{colon}{gap.strip()}"
    try:
        return str(Relation.parse(meant)) if kind and meant != text else ""
    except ConfigError:
        return f"{subject} {kind} {reference}"


def _pool_faults(
    layout: LayoutFields, facts: Sequence[ObjectFacts], pool: str
) -> Iterator[LayoutFault]:
    """Objects that the pool does not have."""
    for name, condition in layout.objects.items():
        try:
            test = parse_condition(condition)
        except ConfigError:
            continue  # Told already.
        if not any(map(test, facts)):
            yield _no_such_object(name, condition, facts, pool, name_meant(condition, facts))


def _no_such_object(
    name: str, condition: str, facts: Sequence[ObjectFacts], pool: str, meant: str
) -> LayoutFault:
    names = first_names([each.name for each in facts], _NAMES_SHOWN)
    given = f"{condition!r}, which no object of pool {pool!r} is"
    return LayoutFault(f"objects.{name}", given, names, meant=meant)


def name_meant(text: str, facts: Sequence[ObjectFacts]) -> str:
    """The object that a text is most like, by its name or by what people call it; "" if there is none."""
    wanted = text.strip("*?").rpartition("=")[2].strip("*? ").lower()
    by_label = {each.label.lower(): each.name for each in facts}
    plain = wanted.replace("_", " ")
    if plain in by_label:
        return by_label[plain]
    if name := closest(plain_name(wanted), [each.name for each in facts]):
        return name
    if label := closest(plain, by_label):
        return by_label[label]
    words = set(plain.split())
    shared = (each.name for each in facts if words & {*each.name.split("_"), *each.label.split()})
    return next(shared, "")


_OPPOSITE = {"left_of": "right_of", "behind": "in_front_of"}
_OPPOSITE |= {other: one for one, other in _OPPOSITE.items()}
_SIDE = tuple(_OPPOSITE)
_APART = ("next_to", "far_from")


def _contradictions(layout: LayoutFields) -> Iterator[LayoutFault]:
    """Relations of which each can hold, but not all."""
    found: list[tuple[int, Relation]] = []
    for place, text in enumerate(layout.relations):
        try:
            found.append((place, Relation.parse(text)))
        except ConfigError:
            continue  # Told already.
    for (i, one), (j, two) in combinations(found, 2):
        if why := _contradiction(one, two):
            given = f"{str(two)!r} contradicts {str(one)!r} (relations[{i}]): {why}"
            yield LayoutFault(f"relations[{j}]", given, "one of both")
    insides = {(each.subject, each.reference) for _, each in found if each.kind == "in"}
    held = {(each.subject, each.reference) for _, each in found if each.kind in ("in", "on")}
    for (a, b), (c, d) in combinations(sorted(insides), 2):
        if a == c and (b, d) not in held and (d, b) not in held:
            yield LayoutFault(
                "relations", f"{a!r} is in {b!r} and in {d!r}", "one of both, or one in the other"
            )
    # Within its cone each side also orders the objects along one axis of the table.
    for less, more in (("left_of", "right_of"), ("in_front_of", "behind")):
        graph: dict[str, set[str]] = {}
        for _, each in found:
            if each.kind == less:
                graph.setdefault(each.reference, set()).add(each.subject)
            elif each.kind == more:
                graph.setdefault(each.subject, set()).add(each.reference)
        try:
            tuple(TopologicalSorter(graph).static_order())
        except CycleError as error:
            ends = error.args[1]
            if len(set(ends)) > 2:
                chain = f" {less} ".join(ends)
                yield LayoutFault("relations", f"they ask for {chain}", "an order in a line")


def _contradiction(one: Relation, two: Relation) -> str:
    """Why two relations cannot hold together; "" if they can."""
    if {one.subject, one.reference} != {two.subject, two.reference}:
        return ""
    kinds = {one.kind, two.kind}
    first, second = one.kind, two.kind
    if one.subject != two.subject:
        second = _OPPOSITE.get(second, second)
    if first in _SIDE and second in _SIDE and first != second:
        return "an object is on one side of another"
    if kinds & {"on", "in"} and kinds & {*_APART, *_SIDE}:
        return "what is on or in another is not beside it"
    far = [each.gap for each in (one, two) if each.kind == "far_from"]
    near = [each.gap for each in (one, two) if each.kind in USUAL and each.kind != "far_from"]
    if far and near and max(far) > min(near):
        return f"a gap of at least {max(far):g} m and of at most {min(near):g} m"
    return ""


def _number_faults(layout: LayoutFields, num_known: int) -> Iterator[LayoutFault]:
    """More objects than a scene can have, and other numbers that cannot be; the pool has `num_known`."""
    number = len(layout.objects) + layout.others
    if number > MAX_SLOTS:
        path = "others" if layout.others > len(layout.objects) else "objects"
        yield LayoutFault(path, f"{number} objects in all", f"up to {MAX_SLOTS}")
    if layout.others and num_known > MOST_ON_SHELF:
        given = f"{layout.others} of a pool of {num_known} objects"
        allowed = f"0 where the pool has more than {MOST_ON_SHELF}"
        yield LayoutFault("others", given, allowed, "naming them in `objects`")
    if layout.theme and not layout.others:
        yield LayoutFault("theme", f"{layout.theme!r} with no `others`", "with others", "others: 4")
    for name, value in layout.clutter.items():
        try:
            Clutter.of({name: value})
        except ConfigError as error:
            fault = LayoutFault.of(f"clutter.{name}", error)
            yield replace(fault, hint="clutter: {stack: 2, near: 0.02}")


def _place_of_error(error: ClutterGenError, layout: LayoutFields) -> str:
    """The place in a layout that an error of its request is about; "" where that is not plain."""
    for place, text in enumerate(layout.arrangements):
        if repr(str(Arrangement.parse(text))) in error.given:
            return f"arrangements[{place}]"
    for name, condition in layout.objects.items():
        if re.search(rf"role {name!r}|{re.escape(condition)!r}", error.given):
            return f"objects.{name}"
    if re.search(r"\bcrowd\b|drawn together", error.given):
        return "crowd"
    fields = ("theme", "clutter", "relations", "poses", "objects", "region", "support")
    return next((field for field in fields if field in error.given), "")


def spec_of_layout(layout: LayoutFields, found: Pool | None = None) -> SceneSpec:
    """The request that a layout without faults is (ConfigError: it has one).

    Args:
      found: the layout's pool, where it is at hand or another one is meant.
    """
    relations = tuple(map(Relation.parse, layout.relations))
    conditions = conditions_of(tuple(layout.objects.items()), relations)
    arranged = parse_arrangements(tuple(layout.arrangements))
    # Only what may be placed is compiled into the world.
    meant = (*conditions.values(), *(each.condition for each in arranged))
    objects = tuple(dict.fromkeys(meant))
    if layout.theme:
        facts = (found or find_pool(layout.pool)).facts
        objects += read_sense().in_theme(layout.theme, facts, layout.pool)
    elif layout.others:
        objects = ()
    return SceneSpec(
        pool=layout.pool,
        objects=objects,
        num_objects=len(conditions) + sum(each.number for each in arranged) + layout.others,
        repeat=True,
        support=layout.support,
        region=layout.region,
        relations=tuple(layout.relations),
        arrangements=tuple(layout.arrangements),
        roles=layout.objects,
        poses=layout.poses,
        clutter=layout.clutter or None,
        natural=layout.natural,
        crowd=layout.crowd,
    )


_FULL = 1.0
_TOO_FULL = 2.5
"""Footprints over the region's area. Of the smallest objects, from where scenes begin to fail; and of those
that a layout names, but for what is on or in another, from where it is refused: `guided`, which lets objects
stand on others, fills 8 of 8 tables with ten of kitchen at 1.5, 4 of 8 at 3.0, 2 of 8 at 4.6."""


def _room_notes(spec: SceneSpec, layout: LayoutFields, pool: Pool) -> list[str]:
    """What is odd about the room that a request has.

    Raises:
      ClutterGenError: objects cannot have room, or what they are asked for is not to be had.
    """
    method = spec.method if isinstance(spec.method, str) else DEFAULT_METHOD
    spec.check_method(method)
    spec.check_sense()
    config = spec.problem_config(method, pool)
    if config.shelf:
        return []
    _, chosen, support, region, _ = check_objects(config, pool)
    relate_objects(chosen, config.placement, config.repeat)
    if config.placement.clutter is not None:
        config.placement.clutter.check(config.placement.num_objects)
    area = area_asked(config, support)
    carried = {
        each.subject for each in map(Relation.parse, layout.relations) if each.kind in ("on", "in")
    }
    standing = [
        _smallest(condition, chosen)
        for name, condition in layout.objects.items()
        if name not in carried
    ]
    covered = crowding(standing, len(standing), region, area) if standing else 0.0
    if covered > _TOO_FULL:
        x, y = 2 * np.array(region.half_extents)
        raise ConfigError(
            f"{len(standing)} objects that are on or in no other cover {covered:.1f} times the area of "
            f"the region of {x:.2f} x {y:.2f} m",
            f"up to {_TOO_FULL:g} times",
            "fewer objects, some on or in others, or a larger support",
        )
    crowded = crowding(chosen, config.placement.num_objects, region, area)
    if max(crowded, covered) <= _FULL:
        return []
    return [f"it is tight: the objects cover {max(crowded, covered):.1f} times the region's area"]


def _smallest(condition: str, objects: Sequence[ObjectAsset]) -> ObjectAsset:
    """The smallest object in plan that a condition means."""
    test = parse_condition(condition)
    meant = [each for each in objects if test(ObjectFacts.of(each))]
    return min(meant, key=lambda each: float(np.prod(each.half_extents[:2])))
