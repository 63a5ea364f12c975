"""Relations that scenes must fulfil: "mug on book", "fork left_of plate", "cup next_to bottle: 0.05"."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, get_args

from cluttergen_jax.config import RelationKind
from cluttergen_jax.errors import ConfigError, closest

# This is read for a command's `--help`: what is slow to load is imported where it is needed.
if TYPE_CHECKING:
    import numpy as np

    from cluttergen_jax.assets.facts import ObjectFacts

KINDS = get_args(RelationKind)
TABLE = "table"
"""What things may be aligned to besides objects: the sides of the queried region."""
SIDES = ("left_of", "right_of", "in_front_of", "behind")
"""Kinds that are meant as one sees it who stands at the region's -y side."""
MOST_RELATIONS = 64
USUAL = {"next_to": 0.05, "far_from": 0.20, "left_of": 0.15, "right_of": 0.15}
USUAL |= {"in_front_of": 0.15, "behind": 0.15}
"""Metres of gap, where a relation of a distance is asked for without one."""
MOST_GAP = 2.0
ARRANGED_ROLE = re.compile(r"(row|stack|nest)-\d+-\d+")
"""Roles within arrangements, which nobody named (`arrangements.roles_and_relations`)."""
_UNDER = "under"
_TERM = re.compile(r"\s*(\S+)\s+(\w+)\s+([^\s:]+)\s*(?::\s*(\S+)\s*)?")
_HINT = "'mug on book', 'fork left_of plate', 'cup next_to bottle:0.05'"


@dataclass(frozen=True)
class Relation:
    """One relation of two objects.

    Attributes:
      subject: the role of what is placed with regard to the other.
      kind: "on", "in", "next_to", "far_from", "left_of", "right_of", "in_front_of", "behind" or "aligned".
      reference: the role of the other; "table" for what is aligned to the region's sides.
      gap: metres, seen from above: at most, or with "far_from" at least; nan where there is none.
    """

    subject: str
    kind: str
    reference: str
    gap: float = math.nan

    @staticmethod
    def parse(text: str) -> Relation:
        """From text: SUBJECT KIND REFERENCE[:GAP]; "a under b" is "b on a".

        Raises:
          ConfigError: it is not of this form, or the gap is out of range.
        """
        match = _TERM.fullmatch(text) if isinstance(text, str) else None
        if match is None:
            raise ConfigError(f"relation {text!r}", "SUBJECT KIND REFERENCE[:GAP in metres]", _HINT)
        subject, kind, reference, gap = match.groups()
        if kind == _UNDER:
            subject, kind, reference = reference, "on", subject
        if kind not in KINDS:
            allowed = ", ".join((*KINDS, _UNDER))
            raise ConfigError(
                f"{kind!r} in relation {text!r}", allowed, _HINT, closest(kind, KINDS)
            )
        if subject == reference:
            raise ConfigError(f"relation {text!r} of an object to itself", "two objects", _HINT)
        if TABLE in (subject, reference) and (kind != "aligned" or subject == TABLE):
            raise ConfigError(f"relation {text!r}", "OBJECT aligned table, or two objects", _HINT)
        return Relation(subject, kind, reference, _parse_gap(text, kind, gap))

    def __str__(self) -> str:
        gap = "" if math.isnan(self.gap) else f":{self.gap:g}"
        return f"{self.subject} {self.kind} {self.reference}{gap}"


def _parse_gap(text: str, kind: str, gap: str | None) -> float:
    if gap is None:
        return USUAL.get(kind, math.nan)
    try:
        value = float(gap)
    except ValueError:
        value = math.nan
    if kind not in USUAL or not 0 < value <= MOST_GAP:
        allowed = f"a gap of up to {MOST_GAP:g} m with {', '.join(USUAL)}; none with the others"
        raise ConfigError(f"{gap!r} in relation {text!r}", allowed, _HINT)
    return value


def parse_relations(texts: Sequence[str]) -> tuple[Relation, ...]:
    """Relations of texts (`Relation.parse`).

    Raises:
      ConfigError: one is not understood, or they go round in a circle: a on b, b on a.
    """
    if isinstance(texts, str):
        raise ConfigError(
            f"relations = {texts!r}", "a sequence of texts", f"relations=({texts!r},)"
        )
    found = tuple(dict.fromkeys(map(Relation.parse, texts)))
    if len(found) > MOST_RELATIONS:
        raise ConfigError(f"{len(found)} relations", f"up to {MOST_RELATIONS}", "fewer")
    order_of(found)
    return found


def is_any_inside(relations: Sequence[Relation]) -> bool:
    """Whether any object is to be in another: it leans on walls, and takes longer to come to rest."""
    return any(each.kind == "in" for each in relations)


def order_of(relations: Sequence[Relation]) -> tuple[str, ...]:
    """All roles, each after those to which it is placed.

    Raises:
      ConfigError: there is no such order.
    """
    graph: dict[str, set[str]] = {}
    for each in relations:
        graph.setdefault(each.subject, set())
        if each.reference != TABLE:
            graph[each.subject].add(each.reference)
    try:
        return tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        circle = " -> ".join(error.args[1])
        raise ConfigError(
            f"relations that go round in a circle: {circle}", "an order of placing"
        ) from None


def parse_roles(given: str | Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Roles and the condition of each, from "plate_1=plate*; plate_2=plate*" or a mapping.

    Raises:
      ConfigError: a name is none, comes twice, or a condition is not understood (`assets.facts`).
    """
    from cluttergen_jax.assets.facts import is_plain_name, parse_condition

    if isinstance(given, Mapping):
        pairs = [(str(name), str(condition)) for name, condition in given.items()]
    else:
        terms = [each for each in given.split(";") if each.strip()]
        pairs = [tuple(map(str.strip, each.partition("=")[::2])) for each in terms]  # type: ignore[misc]
    for name, condition in pairs:
        if not is_plain_name(name) or name == TABLE or not condition:
            raise ConfigError(
                f"role {name!r} of {condition!r}",
                "NAME=CONDITION, a name of a-z, 0-9, _ and -",
                "'cup_1=mug*'",
            )
        parse_condition(condition)
    names = [name for name, _ in pairs]
    if len(set(names)) < len(names):
        raise ConfigError(f"roles {', '.join(names)}", "every name once")
    return tuple(pairs)


def conditions_of(
    roles: Sequence[tuple[str, str]], relations: Sequence[Relation]
) -> dict[str, str]:
    """The condition of each role: as given, else its own name is the condition; "any" is *."""
    conditions = dict(roles)
    for name in order_of(relations):
        conditions.setdefault(name, "*" if name == "any" else name)
    return conditions


def object_names(conditions: Mapping[str, str]) -> list[str]:
    """Names for people: of roles, and of what is arranged, whose roles nobody named, the conditions."""
    return [
        condition if ARRANGED_ROLE.fullmatch(name) else name
        for name, condition in conditions.items()
    ]


def _no_candidate(name: str, condition: str, known: Sequence[str]) -> ConfigError:
    """The error for a role that no object can take."""
    names = [each for each in known if each not in (name, "any")]
    if name == condition:
        given = f"no object is called {name!r}"
        allowed = ", ".join(dict.fromkeys(names))
        return ConfigError(given, allowed, meant=closest(name, names))
    allowed = "a name, a pattern or a condition that one of the objects fulfils"
    meant = closest(condition.strip("*?"), names)
    if kind := ARRANGED_ROLE.fullmatch(name):
        given = f"{condition!r} in `arrangements`, which no object fulfils"
        return ConfigError(given, allowed, f"arrangements=('{kind[1]} {meant or '*'}',)")
    given = f"role {name!r} is {condition!r}, which no object fulfils"
    return ConfigError(given, allowed, f"roles='{name}={meant or '*'}'")


def candidates_of(conditions: Mapping[str, str], facts: Sequence[ObjectFacts]) -> np.ndarray:
    """bool[Q, K]: which of K objects can take which role.

    Raises:
      ConfigError: a condition fits none.
    """
    import numpy as np

    from cluttergen_jax.assets.facts import parse_condition

    rows = []
    for name, condition in conditions.items():
        test = parse_condition(condition)
        row = np.array([test(each) for each in facts])
        if not row.any():
            roles = [each for each, asked in conditions.items() if asked != each]
            raise _no_candidate(name, condition, [*roles, *(each.name for each in facts)])
        rows.append(row)
    return np.array(rows)


def can_be_filled(candidates: np.ndarray) -> bool:
    """Whether bool[Q, K] has a different object for every role."""
    from scipy.optimize import linear_sum_assignment

    if candidates.shape[0] > candidates.shape[1]:
        return False
    rows, columns = linear_sum_assignment(~candidates)
    return bool(candidates[rows, columns].all())
