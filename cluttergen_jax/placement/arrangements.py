"""Arrangements that people make of equal things: "row book*:4", "stack dinner_plate:3", "nest bowl".

Each becomes roles and relations between one and the next, which nobody can ask for by themselves.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.placement.relations import KINDS, TABLE, Relation

ARRANGED = ("in_row_with", "stacked_on", "nested_in")
"""Kinds of relations beside `relations.KINDS`, in whose numbering they follow."""
ALL_KINDS = (*KINDS, *ARRANGED)
ROW, STACK, NEST = (ALL_KINDS.index(kind) for kind in ARRANGED)
_KIND_OF = {"row": "in_row_with", "stack": "stacked_on", "nest": "nested_in"}
WORDS = tuple(_KIND_OF)
USUAL_NUMBER = 3
_MOST = 16
"""Objects of an arrangement."""
_TERM = re.compile(r"\s*(\S+)\s+(.+?)\s*(?::\s*(\S+)\s*)?")
_HINT = "'row label=*book*:4', 'stack dinner_plate:3', 'nest bowl'"


@dataclass(frozen=True)
class Arrangement:
    """One arrangement.

    Attributes:
      kind: "row": upright, side by side, backs in one line; "stack": one centred upon the other; "nest": one
        inside of the other.
      condition: of the objects it is made of, as those of `SceneSpec.objects`.
      number: of objects, 2 to 16.
    """

    kind: str
    condition: str
    number: int = USUAL_NUMBER

    @staticmethod
    def parse(text: str) -> Arrangement:
        """From text: KIND CONDITION[:NUMBER].

        Raises:
          ConfigError: it is not of this form, or the number is out of range.
        """
        from cluttergen_jax.assets.facts import parse_condition

        match = _TERM.fullmatch(text) if isinstance(text, str) else None
        if match is None:
            raise ConfigError(f"arrangement {text!r}", "KIND CONDITION[:NUMBER]", _HINT)
        kind, condition, number = match.groups()
        if kind not in WORDS:
            raise ConfigError(
                f"{kind!r} in arrangement {text!r}", ", ".join(WORDS), _HINT, closest(kind, WORDS)
            )
        parse_condition(condition)
        count = USUAL_NUMBER
        if number is not None:
            count = int(number) if number.isascii() and number.isdigit() else 0
        if not 2 <= count <= _MOST:
            raise ConfigError(f"{number!r} objects in arrangement {text!r}", f"2 to {_MOST}", _HINT)
        return Arrangement(kind, condition, count)

    def __str__(self) -> str:
        return f"{self.kind} {self.condition}:{self.number}"


def parse_arrangements(texts: Sequence[str]) -> tuple[Arrangement, ...]:
    """Arrangements of texts (`Arrangement.parse`); ConfigError where one is not understood."""
    if isinstance(texts, str):
        raise ConfigError(
            f"arrangements = {texts!r}", "a sequence of texts", f"arrangements=({texts!r},)"
        )
    return tuple(map(Arrangement.parse, texts))


def roles_and_relations(
    arrangements: Sequence[Arrangement],
) -> tuple[tuple[tuple[str, str], ...], tuple[Relation, ...]]:
    """Names with their conditions, such as row-1-2, and what holds between one and the next."""
    roles = []
    relations = []
    for place, each in enumerate(arrangements, 1):
        names = [f"{each.kind}-{place}-{number}" for number in range(1, each.number + 1)]
        roles += [(name, each.condition) for name in names]
        if each.kind == "row":
            relations.append(Relation(names[0], _KIND_OF["row"], TABLE))
        relations += [
            Relation(after, _KIND_OF[each.kind], before) for before, after in pairwise(names)
        ]
    return tuple(roles), tuple(relations)
