"""YCB as it is downloaded, with its images: known by the names of folders and files.

YCB's own site has `003_cracker_box/google_16k/textured.obj` (and `poisson`, `tsdf`: other scans of the same
objects); YCB-Video has `003_cracker_box/textured.obj`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.importing.readers.source import ObjectFile

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
