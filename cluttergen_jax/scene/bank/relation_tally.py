"""Which relations scenes of a bank failed at, and by which verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.facts import ObjectFacts, parse_condition
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.placement.relations import Relation, conditions_of, parse_relations
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank.bank import Bank
from cluttergen_jax.scene.bank.record import record_error
from cluttergen_jax.scene.bank.table import COUNTED, count_column
from cluttergen_jax.types import Verdict


@dataclass(frozen=True)
class RelationFailures:
    """One relation of a bank, at which scenes failed.

    Attributes:
      relation: as it was asked for.
      scenes: how many scenes failed; total: of how many.
      verdicts: failed attempts of those scenes by verdict, the most frequent first.
    """

    relation: str
    scenes: int
    total: int
    verdicts: dict[str, int]

    def line(self) -> str:
        """For people."""
        counts = ", ".join(f"{number} {verdict}" for verdict, number in self.verdicts.items())
        text = f"{self.relation!r} failed in {self.scenes} of {self.total} scenes"
        return f"{text}; their failed attempts: {counts}"


class RelationTally:
    """Counts failures by relation; rows are added some at a time.

    A scene that could not be filled failed at the object that took most of its attempts, and so at the
    relations in which that one is to be put somewhere; at none if it has no role.

    Args:
      bank: whose relations count.
    """

    def __init__(self, bank: Bank) -> None:
        self._bank = bank
        self._tests = _tests_of(bank)
        self._scenes: Counter[Relation] = Counter()
        self._verdicts: dict[Relation, Counter[Verdict]] = {}
        self._total = 0
        self._naming = lru_cache(maxsize=None)(self._relations_naming)

    def add(self, rows: pa.Table) -> None:
        """Counts some more rows."""
        self._total += rows.num_rows
        if not self._tests:
            return
        counts = [count_column(each) for each in COUNTED]
        failed = rows.filter(np.logical_not(np.array(rows["is_filled"], bool)))
        for row in failed.select(["objects", "attempts", *counts]).to_pylist():
            stuck = row["objects"][int(np.argmax(row["attempts"]))]
            for relation in self._naming(base_name(stuck)):
                self._scenes[relation] += 1
                tally = self._verdicts.setdefault(relation, Counter())
                tally.update({each: row[count_column(each)] for each in COUNTED})

    def failures(self) -> tuple[RelationFailures, ...]:
        """Those at which scenes failed, the most frequent first."""
        found = []
        for relation, scenes in self._scenes.most_common():
            counts = self._verdicts[relation].most_common()
            failed = {
                each.label: number for each, number in counts if number and each != Verdict.STABLE
            }
            found.append(RelationFailures(str(relation), scenes, self._total, failed))
        return tuple(found)

    def _relations_naming(self, name: str) -> tuple[Relation, ...]:
        """In which an object of this name is the subject; if in none, those of which it is the reference."""
        facts = ObjectFacts.of(self._bank.object(name))
        roles = {role for role, test in self._tests.items() if test(facts)}
        asked = parse_relations(self._bank.recipe["placement"]["relations"])
        subjects = tuple(each for each in asked if each.subject in roles)
        return subjects or tuple(each for each in asked if each.reference in roles)


def _tests_of(bank: Bank) -> dict[str, Callable[[ObjectFacts], bool]]:
    """Tests of objects by the role of a relation that they can take; none where nothing is related."""
    rules = bank.recipe.get("placement", {})
    try:
        relations = parse_relations(rules.get("relations", ()))
        roles = tuple((name, condition) for name, condition in rules.get("roles", ()))
        if not relations:
            return {}
        conditions = conditions_of(roles, relations)
        return {name: parse_condition(condition) for name, condition in conditions.items()}
    except (AttributeError, TypeError, ValueError, ClutterGenError) as error:
        raise record_error(bank.path, error) from error
