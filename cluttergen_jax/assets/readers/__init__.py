"""Readers: from files of many formats to `Shape`s in metres, z up.

source.py finds what a path holds; mesh_file.py, urdf.py and mjcf.py each read one family; check.py refuses
shapes of impossible size.
"""

from cluttergen_jax.assets.readers.read import read_shape, read_source
from cluttergen_jax.assets.readers.source import ReadOptions, Source, find_sources
from cluttergen_jax.assets.readers.ycb import ycb_sources

__all__ = ["ReadOptions", "Source", "find_sources", "read_shape", "read_source", "ycb_sources"]
