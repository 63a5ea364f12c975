"""Readers: from files of many formats to `Shape`s in metres, z up.

tree.py finds what a path holds; mesh_file.py, urdf.py, sdf.py and mjcf.py each read one family; source.py
says which way is up; damage.py refuses files that are broken or announce more than they hold; read.py, shapes
of impossible size.
"""

from cluttergen_jax.importing.readers.read import read_shape, read_source
from cluttergen_jax.importing.readers.source import ObjectFile, ReadOptions
from cluttergen_jax.importing.readers.tree import Skipped, Survey, find_sources, survey

__all__ = [
    "ObjectFile",
    "ReadOptions",
    "Skipped",
    "Survey",
    "find_sources",
    "read_shape",
    "read_source",
    "survey",
]
