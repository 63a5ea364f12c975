"""Which bodies of a file are a piece of furniture: all that stand there, or the one that is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile, find_sources
from cluttergen_jax.importing.readers.source import make_source
from cluttergen_jax.importing.scenery import MIN_CHAIN, BodyFacts, world_facts

_GLTF = (".glb", ".gltf")
_MOST_NAMED = 8


def find_furniture(path: str | Path) -> tuple[ObjectFile, list[str]]:
    """The one piece of furniture that a path means.

    Args:
      path: a file, a folder that holds one, or FILE#BODY: a body of an MJCF file, a link of a URDF, a model
        or link of an SDF file, a node of a glTF file, each with all that hangs on it.

    Returns:
      It, and in words which bodies are taken as one, and which are left out.

    Raises:
      AssetError: nothing is there, or it holds several files of furniture, or a body of a file without any.
    """
    file, body = _split(path)
    sources = find_sources(file)
    places = list(dict.fromkeys(source.path for source in sources))
    if len(places) > 1:
        names = ", ".join(str(each.relative_to(file)) for each in places[:_MOST_NAMED])
        raise AssetError(
            f"{file} holds {len(places)} pieces of furniture ({names})", "one", str(places[0])
        )
    first = sources[0]
    if body:
        if first.kind == "mesh" and first.path.suffix.lower() not in _GLTF:
            raise AssetError(
                f"{str(path)!r}: {first.path.suffix[1:].upper()} has no bodies",
                "a body of an MJCF, URDF, SDF or glTF file",
                str(file),
            )
        return replace(make_source(first.path, first.kind, body), body=body), []
    if len(sources) == 1:
        return first, []
    bodies = [source.body for source in sources]
    taken, notes = _furniture_of(
        bodies, call_limited(first.path, world_facts, first.path) if first.kind == "mjcf" else []
    )
    said = f"taken as one piece of furniture: {_names(taken)} ({first.path.name}#{taken[0]} takes that alone)"
    return replace(make_source(first.path, first.kind), bodies=tuple(taken)), [said, *notes]


def _split(path: str | Path) -> tuple[Path, str]:
    """A file and the body behind "#"; a file whose own name has that sign goes before."""
    if Path(path).exists():
        return Path(path), ""
    text = str(path)
    places = [k for k, letter in enumerate(text) if letter == "#" and Path(text[:k]).exists()]
    return (Path(text[: places[0]]), text[places[0] + 1 :]) if places else (Path(path), "")


def _furniture_of(bodies: Sequence[str], facts: Sequence[BodyFacts]) -> tuple[list[str], list[str]]:
    """Those that stand fixed in a world, all if none does; and in words what is left out."""
    if len(facts) != len(bodies):
        return list(bodies), []
    why = {
        body: reason
        for body, each in zip(bodies, facts, strict=True)
        if (reason := _why_no_furniture(each))
    }
    taken = [body for body in bodies if body not in why]
    if not taken:
        return list(bodies), []
    reasons = dict.fromkeys(why.values())
    return taken, [
        f"left out, {reason}: {_names([body for body, own in why.items() if own == reason])}"
        for reason in reasons
    ]


def _why_no_furniture(facts: BodyFacts) -> str:
    if facts.is_mocap:
        return "as a program moves them (mocap)"
    if facts.chain >= MIN_CHAIN:
        return "as they have chains of joints, as robots have"
    return "as they move freely" if facts.is_free else ""


def _names(bodies: Sequence[str]) -> str:
    more = f" and {len(bodies) - _MOST_NAMED} more" if len(bodies) > _MOST_NAMED else ""
    return ", ".join(bodies[:_MOST_NAMED]) + more
