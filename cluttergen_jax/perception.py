"""Known objects in colour and depth images: frames, segmenters, and poses by registration."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.downstream.perception.finder import SceneFinder
    from cluttergen_jax.downstream.perception.frames import Frame, read_frame, write_frame
    from cluttergen_jax.downstream.perception.segmenter import (
        embedded_segmenters as list_segmenters,
    )
    from cluttergen_jax.downstream.perception.segmenter import load_segmenter
    from cluttergen_jax.downstream.perception.types import Segmentation

__all__ = [
    "Frame",
    "SceneFinder",
    "Segmentation",
    "list_segmenters",
    "load_segmenter",
    "read_frame",
    "write_frame",
]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "Frame": "downstream.perception.frames:Frame",
        "SceneFinder": "downstream.perception.finder:SceneFinder",
        "Segmentation": "downstream.perception.types:Segmentation",
        "list_segmenters": "downstream.perception.segmenter:embedded_segmenters",
        "load_segmenter": "downstream.perception.segmenter:load_segmenter",
        "read_frame": "downstream.perception.frames:read_frame",
        "write_frame": "downstream.perception.frames:write_frame",
    },
)
