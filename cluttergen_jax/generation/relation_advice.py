"""What helps where scenes fail at relations: said before work as far as it is known, else after it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cluttergen_jax.placement.problem import Problem
from cluttergen_jax.placement.related import IN
from cluttergen_jax.placement.relations import SIDES, Relation, parse_relations
from cluttergen_jax.placement.ways_in import passes_through
from cluttergen_jax.scene.bank.relation_tally import RelationFailures

_WIDER = 2.0
"""Times the gap that was asked for is advised where things find no room beside each other."""


def advice_on(failures: RelationFailures) -> str:
    """A sentence for one relation."""
    relation = Relation.parse(failures.relation)
    subject = relation.subject
    reference = relation.reference
    verdicts = tuple(failures.verdicts)
    worst = verdicts[0] if verdicts else ""
    wider = f"{subject} {relation.kind} {reference}:{_WIDER * relation.gap:g}"
    if relation.kind == "in":
        helps = f"a larger container than {reference}, or a smaller object than {subject}"
    elif relation.kind == "on":
        helps = f"a wider, flatter or heavier {reference}, or a smaller or lighter {subject}"
    elif relation.kind in (*SIDES, "next_to"):
        helps = f"a larger gap, {wider!r}, a larger region or fewer objects"
    elif relation.kind == "far_from":
        nearer = f"{subject} far_from {reference}:{relation.gap / _WIDER:g}"
        helps = f"a smaller gap, {nearer!r}, or a larger region"
    else:
        helps = "a larger `budget`, or one that asks for less"
    found = f", mostly {worst}" if worst else ""
    return f"{failures.relation!r} often fails{found}; try {helps}"


def relation_notes(problem: Problem) -> Iterator[str]:
    """Things that are to be in others and were found to go in in no orientation, with the sizes of both."""
    related = problem.rules.related
    hollows = problem.rules.geometry.hollows
    if related is None or related.goes_in is None or hollows is None:
        return
    goes_in = np.asarray(related.goes_in)
    candidates = np.asarray(related.candidates)
    half = np.asarray(hollows.half_extents)
    asked = parse_relations(problem.config.placement.relations)
    for place in np.flatnonzero(np.asarray(related.kind) == IN).tolist():
        pairs = candidates[int(related.subject[place])][:, None]
        pairs = pairs & candidates[int(related.reference[place])]
        np.fill_diagonal(pairs, False)
        if not pairs.any() or (pairs & goes_in).any():
            continue
        index, container = np.argwhere(pairs)[0].tolist()
        names = problem.world.names
        own = problem.world.objects[index].half_extents
        text = f"note: {str(asked[place])!r}: {names[index]} does not go into {names[container]}: "
        room = f"the opening of {names[container]}, {_size(half[container, :2])}"
        if passes_through(own, hollows, container):
            text += (
                f"of some hundred releases over {room}, none came to rest inside, {_size(own)}; "
            )
            text += "scenes will hardly succeed"
        else:
            text += f"its shorter sides, {_size(np.sort(own)[:2])}, are wider than {room}; "
            text += "scenes will not succeed, though placing is tried"
        yield f"{text}; a larger container, or a smaller object, helps"


def _size(half_extents: np.ndarray) -> str:
    return " x ".join(f"{2000 * each:.0f}" for each in half_extents.tolist()) + " mm"
