"""Goals of a user's own: a bank of target layouts, or relations told in words."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from cluttergen_jax.assets import ObjectAsset, ObjectFacts, Rectangle, SupportAsset, object_hash
from cluttergen_jax.downstream.rearrange.layouts import SceneDraw
from cluttergen_jax.downstream.rearrange.task import RearrangeResult
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement import (
    KINDS,
    Relation,
    can_be_filled,
    candidates_of,
    conditions_of,
    parse_relations,
)
from cluttergen_jax.scene import Scene, read_bank, read_scenes

_PHRASES = {"on top of": "on", "onto": "on", "into": "in", "inside": "in", "beside": "next_to"}
_PHRASES |= {kind.replace("_", " "): kind for kind in (*KINDS, "under")}
_VERB = re.compile(r"^(?:please )?(?:put|place|move|set|bring|lay) ", re.IGNORECASE)
_FILLER = re.compile(r"(?:(?<!next )\bto the|\b(?:the|a|an)) ", re.IGNORECASE)
_NUM_DRAWN = 32
"""Layouts that are drawn at a time: few objects move, and each is looked for where its relation holds."""
_HINT = (
    "'put the candle left of the basket', 'candle left_of basket; toy_car behind candle', or a bank"
)


class Goal(NamedTuple):
    """What an episode has to reach.

    Attributes:
      moved: of the scene's objects those that have to move, by number.
      layouts: `RearrangeTask.goals`.
    """

    moved: list[int]
    layouts: Callable[[int, np.ndarray], np.ndarray]


def parse_goal(text: str) -> tuple[Relation, ...]:
    """The relations of a text: sentences or relations, divided by semicolons.

    Raises:
      ConfigError: one is not understood.
    """
    return parse_relations([_plain_relation(each) for each in text.split(";") if each.strip(" .")])


def _plain_relation(text: str) -> str:
    with suppress(ConfigError):
        return str(Relation.parse(text))
    words = re.sub(r"[\s_]+", " ", text.strip(" .\n\t"))
    words = _FILLER.sub("", _VERB.sub("", words))
    for phrase in sorted(_PHRASES, key=len, reverse=True):
        subject, found, reference = words.partition(f" {phrase} ")
        if found:
            name, _, gap = reference.partition(":")
            terms = (subject.strip(), _PHRASES[phrase], name.strip())
            return " ".join(each.replace(" ", "_") for each in terms) + (
                f":{gap.strip()}" if gap else ""
            )
    raise ConfigError(
        f"goal {text.strip()!r}", f"an object, one of {', '.join(_PHRASES)}, an object", _HINT
    )


class RelationGoals:
    """Layouts in which relations hold: what each is said of moves, all else stays.

    Args:
      text: the relations (`parse_goal`).
      make_draw: of relations a `SceneDraw` of the objects among which they are to hold.
    """

    def __init__(self, text: str, make_draw: Callable[[Sequence[str]], SceneDraw]) -> None:
        self._relations = parse_goal(text)
        self._make_draw = make_draw
        if not self._relations:
            raise ConfigError(f"goals = {text!r}", "one relation or more", _HINT)
        self._conditions = conditions_of((), self._relations)
        self.name = "; ".join(map(str, self._relations))

    @cached_property
    def _draw(self) -> SceneDraw:
        return self._make_draw([str(each) for each in self._relations])

    def fits(self, objects: Sequence[ObjectAsset]) -> bool:
        """Whether there is another object for every role."""
        return self._candidates(objects) is not None

    def _candidates(self, objects: Sequence[ObjectAsset]) -> np.ndarray | None:
        facts = [ObjectFacts.of(each) for each in objects]
        try:
            found = candidates_of(self._conditions, facts)
        except ConfigError:
            return None
        return found if can_be_filled(found) else None

    def check(self, objects: Sequence[ObjectAsset]) -> None:
        """Refuses relations of objects that are not among these (ConfigError)."""
        found = candidates_of(self._conditions, [ObjectFacts.of(each) for each in objects])
        if not can_be_filled(found):
            raise ConfigError(f"goals {self.name!r}", "a different object for each name", _HINT)

    def __call__(
        self, scene: Scene, numbers: Sequence[int], seed: int, region: Rectangle
    ) -> Goal | None:
        """Which objects take which role in a scene, at random; None if it lacks one.

        Args:
          numbers: of the scene's objects among those of the `SceneDraw`.
          region: where what is moved goes.
        """
        candidates = self._candidates(scene.objects)
        if candidates is None:
            return None
        noise = np.random.default_rng(seed).random(candidates.shape)
        taken = linear_sum_assignment(noise + 1e3 * ~candidates)[1].tolist()
        subjects = {each.subject for each in self._relations}
        moved = [k for name, k in zip(self._conditions, taken, strict=True) if name in subjects]
        rest = [k for k in range(len(numbers)) if k not in moved]

        def layouts(draw: int, poses: np.ndarray) -> np.ndarray:
            chosen, standing, filled = ([numbers[k] for k in each] for each in (moved, rest, taken))
            return self._draw(seed + draw, chosen, region, standing, poses, _NUM_DRAWN, filled)

        return Goal(moved, layouts)


class BankGoals:
    """Target layouts of a bank, or one of its scenes: the objects that they have move there, all else stays.

    Args:
      place: the bank's folder, or FOLDER:INDEX.
    """

    def __init__(self, place: str) -> None:
        folder, index = bank_place(place)
        stored = list(read_scenes(read_bank(folder)))
        known = [each.origin.index for each in stored if each.origin is not None]
        self._scenes = [
            each
            for each in stored
            if index is None or (each.origin is not None and each.origin.index == index)
        ]
        if not stored:
            raise ConfigError(
                f"goals = {place!r}, where no scene is a success", "one or more", _HINT
            )
        if not self._scenes:
            more = " ..." if len(known) > 20 else ""
            raise ConfigError(
                f"goals = {place!r}",
                f"scenes {', '.join(map(str, known[:20]))}{more}",
                f"{folder}:{known[0]}",
            )
        self.name = place

    def check_support(self, support: SupportAsset) -> None:
        """Refuses layouts for another support (ConfigError)."""
        other = self._scenes[0].support
        if other.name != support.name or abs(other.top - support.top) > 1e-6:
            raise ConfigError(
                f"goals on {other.name!r}, scenes on {support.name!r}", "the same support"
            )

    def fits(self, objects: Sequence[ObjectAsset]) -> bool:
        """Whether these are all that one of the layouts has."""
        known = Counter(map(object_hash, objects))
        return any(Counter(map(object_hash, each.objects)) <= known for each in self._scenes)

    def __call__(
        self, scene: Scene, numbers: Sequence[int], seed: int, region: Rectangle
    ) -> Goal | None:
        """The layouts of the first scene all of whose objects this one has, and of those with the same."""
        known = {
            name: object_hash(each) for name, each in zip(scene.names, scene.objects, strict=True)
        }
        fitting = [each for each in self._scenes if self._has(known, each)]
        if not fitting:
            return None
        names = fitting[0].names
        alike = [each for each in fitting if set(each.names) == set(names)]
        poses = np.stack([each.poses[[each.names.index(name) for name in names]] for each in alike])

        def layouts(draw: int, standing: np.ndarray) -> np.ndarray:
            return poses[: 0 if draw else None].astype(np.float64)

        return Goal([scene.names.index(name) for name in names], layouts)

    @staticmethod
    def _has(known: dict[str, str], goal: Scene) -> bool:
        pairs = zip(goal.names, goal.objects, strict=True)
        return all(known.get(name) == object_hash(each) for name, each in pairs)


def is_bank(text: str) -> bool:
    """Whether goals are told by a folder, or by FOLDER:INDEX."""
    return Path(text).is_dir() or Path(text.rpartition(":")[0] or text).is_dir()


def bank_place(text: str) -> tuple[str, int | None]:
    """The folder, and the index of one of its scenes if there is one.

    Raises:
      ConfigError: what follows the colon is no whole number.
    """
    if Path(text).is_dir():
        return text, None
    folder, _, index = text.rpartition(":")
    if not re.fullmatch(r"[0-9]+", index):
        raise ConfigError(
            f"goals = {text!r}", "FOLDER, or FOLDER:INDEX with a whole number", f"{folder}:0"
        )
    return folder, int(index)


def task_words(goals: str) -> Callable[[RearrangeResult], str]:
    """What the task of an episode is called, of its row."""
    if goals and not is_bank(goals):
        told = [
            f"put the {each.subject} {each.kind} the {each.reference}" for each in parse_goal(goals)
        ]
        words = "; ".join(told)
        return lambda row: words.replace("_", " ")

    def words_of(row: RearrangeResult) -> str:
        return f"bring {', '.join(f'the {name}' for name in row.objects)} to their places".replace(
            "_", " "
        )

    return words_of
