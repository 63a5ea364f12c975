"""Finding objects: a file, or a tree of folders in which nothing is passed over without a word.

YCB's own site has `003_cracker_box/google_16k/textured.obj` (and `poisson`, `tsdf`: other scans of the same
objects); YCB-Video has `003_cracker_box/textured.obj`. Both are known by the names of folders and files.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.errors import AssetError, closest
from cluttergen_jax.importing.limited import call_limited
from cluttergen_jax.importing.readers.pieces import (
    MESH_SUFFIXES,
    MSH,
    Belonging,
    ModelFile,
    model_file,
)
from cluttergen_jax.importing.readers.sdf import CONFIG, config_of
from cluttergen_jax.importing.readers.sets import named_pieces
from cluttergen_jax.importing.readers.source import (
    GENERIC,
    ObjectFile,
    label_of,
    make_names_distinct,
    make_source,
    says_something,
)
from cluttergen_jax.importing.readers.urdf import XACRO, how_to_process

MODEL_SUFFIXES = (".urdf", ".sdf", ".xml")
SETTINGS = "objects.toml"
"""Settings of the objects in a folder (`importing.settings`)."""

# Materials, textures and buffers belong to a mesh beside them; label.json to a URDF, model.config to an SDF.
_COMPANIONS = (
    *(".mtl", ".material", ".bin", ".png", ".jpg", ".jpeg", ".bmp", ".tga"),
    *(".tif", ".tiff", ".webp", ".gif"),
)
_NOTES = (SETTINGS, "label.json", CONFIG)
_OTHER_FORMATS = re.compile(
    r"\.(fbx|blend|usd[acz]?|3ds|3mf|max|ma|mb|off|x3d|wrl|step|stp|iges|igs|drc|skp)"
)
_STANDS_IN = re.compile(GENERIC)


@dataclass(frozen=True)
class Skipped:
    """A file or folder that was not imported, and why."""

    name: str  # Its path, from the folder on that was searched.
    reason: str
    is_piece: bool = False  # It belongs to an object, or to one that was left out.


@dataclass(frozen=True)
class Survey:
    """What a path holds: objects in sorted order, what was passed over, and all files."""

    sources: tuple[ObjectFile, ...]
    skipped: tuple[Skipped, ...] = ()
    files: tuple[Path, ...] = ()


def find_sources(path: str | Path) -> list[ObjectFile]:
    """`survey(path).sources`, as a list."""
    return list(survey(path).sources)


def survey(path: str | Path) -> Survey:
    """`find_all`, with distinct names."""
    found = find_all(path)
    return replace(found, sources=tuple(make_names_distinct(found.sources)))


def find_all(path: str | Path) -> Survey:
    """Every object that `path` holds, and every file that is none; several objects may have one name.

    With "#" and a name behind a file, it is that body of a model, or that node of a mesh file.

    The meshes that a URDF, SDF or MJCF file names are its pieces; all others are objects of their own. One
    object in several formats counts once. Each real folder is entered once, however many links lead there.

    Raises:
      AssetError: nothing is there, or nothing that can be read.
    """
    given = str(path)
    path = Path(path)
    if not os.path.exists(path):
        if "#" in given:
            return _chosen(given)
        raise AssetError(
            f"{path} does not exist", "a mesh, URDF, SDF or MJCF file, or a folder of them"
        )
    if path.suffix.lower() == XACRO and path.is_file():
        raise AssetError(f"{path} is an unprocessed xacro", "URDF", how_to_process(path))
    if path.is_dir():
        tree = _Tree(path)
        tree.enter_all()
        sources, others = best_scans(list(tree.sources()))
        for scan, best in others.items():
            tree.skip(scan, f"another scan of the object in {best.parent.name}")
        files = tuple(file for here in tree.files.values() for file in here)
        found = Survey(tuple(sources), tuple(tree.skipped), files)
    else:
        found = Survey(tuple(_from_file(path)), files=(path,))
    if not found.sources:
        passed = ", ".join(each.name for each in found.skipped[:5])
        raise AssetError(
            f"{path} holds no object{f' (skipped: {passed})' if passed else ''}",
            ", ".join([*MESH_SUFFIXES, ".urdf", ".sdf", ".xml (MJCF)"]),
        )
    return found


def _chosen(text: str) -> Survey:
    """One body of a model file, or one node of a mesh file, as `file.glb#node` names it."""
    cuts = [place for place, sign in enumerate(text) if sign == "#"]
    cut = next((each for each in cuts if os.path.isfile(text[:each])), None)
    if cut is None or cut == len(text) - 1:
        raise AssetError(
            f"{text} does not exist", "a file, and behind '#' the name of what is in it"
        )
    file = Path(text[:cut])
    body = text[cut + 1 :]
    if file.suffix.lower() in MESH_SUFFIXES:
        return Survey((node_source(file, body),), files=(file,))
    sources = find_all(file).sources
    known = {each.body.removeprefix("#") or each.name: each for each in sources}
    if body not in known:
        given = f"{file} holds nothing called {body!r}"
        raise AssetError(given, ", ".join(known), meant=closest(body, known))
    return Survey((known[body],), files=(file,))


def node_source(file: Path, node: str) -> ObjectFile:
    """The source of one node of a mesh file."""
    is_told = says_something(node)
    source = make_source(
        file, "mesh", node if is_told else "", behind="" if is_told else f"-{node}"
    )
    return replace(source, body=node)


def _from_file(path: Path) -> Iterator[ObjectFile]:
    if path.suffix.lower() in MESH_SUFFIXES:
        yield make_source(path, "mesh")
    elif path.suffix.lower() in MODEL_SUFFIXES:
        model = call_limited(path, model_file, path, True)
        if isinstance(model, str):
            raise AssetError(f"{path} is no object: {model}", "a URDF, SDF or MJCF file")
        yield from _sources_of(model)


def _model_or_fault(path: Path) -> ModelFile | str:
    """`model_file` in a process with limits; what ends that is no object."""
    try:
        return call_limited(path, model_file, path)
    except AssetError as error:
        return str(error)


def _sources_of(model: ModelFile) -> Iterator[ObjectFile]:
    """One source for each body that hangs on the world body; the file itself if it does not say."""
    if len(model.bodies) < 2:
        source = make_source(model.path, model.kind)
        called = config_of(model.path)[0] if model.kind == "sdf" else ""
        yield replace(source, label=label_of(called)) if called else source
        return
    for index, name in enumerate(model.bodies):
        source = make_source(model.path, model.kind, name, behind="" if name else f"-{index}")
        yield replace(source, body=name or f"#{index}")


@dataclass
class _Tree:
    """A walk through the folders below `root`: first everything is looked at, then sources are chosen.

    Attributes:
      named: pieces, with the JSON that names them so.
    """

    root: Path
    skipped: list[Skipped] = field(default_factory=list)
    files: dict[Path, list[Path]] = field(default_factory=dict)
    named: dict[Path, Path] = field(default_factory=dict)

    def enter_all(self) -> None:
        """Lists each real folder once: first those that lie here, then those that only links lead to."""
        seen: dict[Path, Path] = {}
        links: list[Path] = []
        self._enter(self.root, seen, links)
        above = self.root.resolve().parents
        while links:
            link = links.pop(0)
            real = link.resolve()
            if real in above:
                self.skip(link, "a link to a folder that holds this one")
            elif real in seen:
                self.skip(
                    link, f"a link to a folder that is imported already: {self._name(seen[real])}"
                )
            else:
                self._enter(link, seen, links)

    def _enter(self, folder: Path, seen: dict[Path, Path], links: list[Path]) -> None:
        seen[folder.resolve()] = folder
        try:
            children = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
        except OSError as error:
            self.skip(folder, f"cannot be opened ({error.strerror})")
            return
        self.files[folder] = [each for each in children if each.is_file()]
        for each in children:
            if each.is_dir() and each.is_symlink():
                links.append(each)
            elif each.is_dir():
                self._enter(each, seen, links)
            elif not each.is_file():
                self.skip(each, "a link that leads nowhere" if each.is_symlink() else "not a file")

    def sources(self) -> Iterator[ObjectFile]:
        """What is imported; the rest is added to `skipped`."""
        every = [file for files in self.files.values() for file in files]
        models = {
            file: _model_or_fault(file) for file in every if file.suffix.lower() in MODEL_SUFFIXES
        }
        readable = [model for model in models.values() if isinstance(model, ModelFile)]
        owner: dict[Path, ModelFile] = {}
        for model in readable:
            for file in model.files | model.includes:
                owner.setdefault(file, model)
        belonging = Belonging(self.files, readable, owner)
        self.named = named_pieces(every)
        for files in self.files.values():
            here = [models[file] for file in files if file in models]
            for file in files:
                self._explain(file, models.get(file), owner)
            yield from self._models(here, owner, belonging)
            yield from self._meshes(files, here, owner, belonging)

    def _explain(
        self, file: Path, model: ModelFile | str | None, owner: dict[Path, ModelFile]
    ) -> None:
        """Says why a file that can be no object is none."""
        suffix = file.suffix.lower()
        fault = model.fault if isinstance(model, ModelFile) else model
        if fault:
            part_of = owner.get(file.resolve())
            self.skip(
                file,
                f"included by {part_of.path.name}" if part_of else fault,
                is_piece=part_of is not None,
            )
        elif suffix == XACRO:
            self.skip(file, f"an unprocessed xacro: `{how_to_process(file)}` makes URDF of it")
        elif suffix == MSH:
            if file.resolve() not in owner:
                self.skip(
                    file, "MSH is read where an MJCF file names it, and none does", is_piece=True
                )
        elif _OTHER_FORMATS.fullmatch(suffix):
            self.skip(
                file, f"{suffix[1:].upper()} is not read; Blender and others can save it as GLB"
            )
        elif not (model or suffix in (*MESH_SUFFIXES, *_COMPANIONS) or file.name in _NOTES):
            self.skip(file, "not a mesh format")

    def _models(
        self, here: list[ModelFile | str], owner: dict[Path, ModelFile], belonging: Belonging
    ) -> Iterator[ObjectFile]:
        first: dict[str, Path] = {}
        for model in here:
            if isinstance(model, str) or model.fault:
                continue
            part_of = owner.get(model.path.resolve())
            if part_of is not None and part_of is not model:
                self.skip(model.path, f"included by {part_of.path.name}", is_piece=True)
                continue
            if reason := belonging.why_model(model):
                self.skip(model.path, reason, is_piece=True)
                continue
            twin = first.setdefault(model.path.stem, model.path)
            if twin is not model.path and len(model.bodies) < 2:
                self.skip(model.path, f"the same object as {twin.name}", is_piece=True)
            else:
                yield from _sources_of(model)

    def _meshes(
        self,
        files: list[Path],
        here: list[ModelFile | str],
        owner: dict[Path, ModelFile],
        belonging: Belonging,
    ) -> Iterator[ObjectFile]:
        """Mesh files that no model names, one for each object."""
        meshes = [each for each in files if each.suffix.lower() in MESH_SUFFIXES]
        meshes.sort(
            key=lambda each: (
                each.stem == "collision",
                MESH_SUFFIXES.index(each.suffix.lower()),
                each.name,
            )
        )
        owned = {each for each in meshes if each.resolve() in owner}
        models = [each.path for each in here if isinstance(each, ModelFile) and not each.fault]
        best = {each.stem: each for each in (*models, *owned)}
        chosen = []
        for mesh in (each for each in meshes if each not in owned):
            by = self.named.get(mesh.resolve())
            if reason := f"a piece that {by.name} names" if by else belonging.why_mesh(mesh):
                self.skip(mesh, reason, is_piece=True)
                continue
            key = "" if _STANDS_IN.fullmatch(mesh.stem.lower()) else mesh.stem
            twin = best.setdefault(key, mesh)
            if twin is mesh:
                chosen.append(mesh)
            else:
                self.skip(mesh, f"the same object as {twin.name}", is_piece=True)
        for mesh in sorted(chosen):
            yield make_source(mesh, "mesh", belonging.title(mesh))

    def skip(self, path: Path, reason: str, is_piece: bool = False) -> None:
        self.skipped.append(Skipped(self._name(path), reason, is_piece))

    def _name(self, path: Path) -> str:
        return str(path.relative_to(self.root.parent))


YCB_LICENCE = "CC BY 4.0"
YCB_ATTRIBUTION = (
    "YCB Object and Model Set: B. Calli, A. Singh, A. Walsman, S. Srinivasa, P. Abbeel and A. M. Dollar, "
    "'The YCB object and Model set', ICAR 2015. Licensed under CC BY 4.0; meshes cut into convex parts here."
)
_SCANS = ("google_16k", "google_64k", "google_512k", "YCB-Video", "poisson", "tsdf")
"""The best first: those with images, and of these one of a size that is drawn quickly."""
_FOLDER = re.compile(r"(\d{3})(?:-[a-z])?[_-](.+)")
_FILE = re.compile(
    r"(textured|textured_simple|textured_simple_reordered|nontextured)\.(obj|ply|stl)"
)
_NAMES = re.findall(
    r"\w+",
    """001_chips_can 002_master_chef_can 003_cracker_box 004_sugar_box 005_tomato_soup_can 006_mustard_bottle
    007_tuna_fish_can 008_pudding_box 009_gelatin_box 010_potted_meat_can 011_banana 012_strawberry 013_apple
    014_lemon 015_peach 016_pear 017_orange 018_plum 019_pitcher_base 021_bleach_cleanser 022_windex_bottle
    023_wine_glass 024_bowl 025_mug 026_sponge 027_skillet 028_skillet_lid 029_plate 030_fork 031_spoon
    032_knife 033_spatula 035_power_drill 036_wood_block 037_scissors 038_padlock 039_key 040_large_marker
    041_small_marker 042_adjustable_wrench 043_phillips_screwdriver 044_flat_screwdriver 046_plastic_bolt
    047_plastic_nut 048_hammer 049_small_clamp 050_medium_clamp 051_large_clamp 052_extra_large_clamp
    053_mini_soccer_ball 054_softball 055_baseball 056_tennis_ball 057_racquetball 058_golf_ball 059_chain
    061_foam_brick 062_dice 063_marbles 065_cups 070_colored_wood_blocks 071_nine_hole_peg_test
    072_toy_airplane 073_lego_duplo 076_timer 077_rubiks_cube""",
)


def ycb_provenance(path: Path) -> Provenance | None:
    """YCB's terms for a mesh file of its downloads; None for any other file."""
    scan = _scan_of(path)
    return scan and Provenance(
        f"YCB Object and Model Set ({scan[1]})", YCB_LICENCE, YCB_ATTRIBUTION
    )


def best_scans(sources: Sequence[ObjectFile]) -> tuple[list[ObjectFile], dict[Path, Path]]:
    """The sources, of each YCB object the best scan alone, called after the object.

    Returns:
      The sources that stay, and by the path of each other scan the one that stands for it.
    """
    best: dict[Path, ObjectFile] = {}
    for source in sources:
        if (scan := _scan_of(source.path)) is not None:
            rival = best.setdefault(scan[0], source)
            if _rank(source) < _rank(rival):
                best[scan[0]] = source
    kept = []
    others = {}
    for source in sources:
        scan = _scan_of(source.path)
        if scan is None:
            kept.append(source)
        elif (own := best[scan[0]]) is source:
            label = scan[0].name.partition("_")[2].replace("_", " ") or source.label
            kept.append(replace(source, name=scan[0].name.lower(), label=label))
        else:
            others[source.path] = own.path
    return kept, others


def _rank(source: ObjectFile) -> int:
    scan = _scan_of(source.path)
    return len(_SCANS) if scan is None else _SCANS.index(scan[1])


def _scan_of(path: Path) -> tuple[Path, str] | None:
    """The folder of the YCB object that a file shows, and which scan it is; None for other files."""
    folder = path.resolve().parent
    kind = folder.name if folder.name in _SCANS else "YCB-Video"
    own = folder if kind == "YCB-Video" else folder.parent
    named = _FOLDER.fullmatch(own.name)
    is_known = named is not None and f"{named[1]}_{named[2]}" in _NAMES
    return (own, kind) if is_known and _FILE.fullmatch(path.name) else None
