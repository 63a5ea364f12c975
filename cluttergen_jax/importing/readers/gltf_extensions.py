"""glTF's extensions: which are understood, and what undoes those that are not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.gltf_file import Document

DRACO = "KHR_draco_mesh_compression"
INSTANCING = "EXT_mesh_gpu_instancing"
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_UNDERSTOOD = (DRACO, INSTANCING, "KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp")
# They say how a surface looks, or nothing about it: the shape is the same without them.
_OF_LOOKS = (
    *("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "EXT_lights_"),
    *("KHR_xmp", "KHR_animation_pointer"),
)
_DRAWN_ALIKE = ("KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness")
_NO_SURFACE = (0, 1, 2, 3)
"""Modes of primitives that are points and lines."""


def check_understood(path: Path, document: Document) -> None:
    """Refuses a file whose shape cannot be read without an extension that is not understood.

    Raises:
      AssetError: it names the extension, and what undoes it.
    """
    wanted = [name for name in _names(document, "extensionsRequired") if not _is_followed(name)]
    wanted += [name for name in _MESHOPT if name not in wanted and _is_all_that_there_is(name, document)]
    if wanted:
        undo = (
            f"gltf-transform copy {path.name} plain.glb" if wanted[0] in _MESHOPT else "exporting without it"
        )
        raise AssetError(
            f"{path} needs the glTF extension {', '.join(wanted)}, which is not read",
            ", ".join(_UNDERSTOOD),
            undo,
        )


def extension_notes(document: Document) -> Iterator[str]:
    """What is not followed, or was decided, of extensions and of surfaces that are no triangles."""
    required, used = _names(document, "extensionsRequired"), _names(document, "extensionsUsed")
    for name in required:
        if name not in (*_UNDERSTOOD, *_DRAWN_ALIKE):
            yield f"its glTF extension {name} is not followed: its colours may differ"
    if others := [name for name in used if not _is_followed(name) and name not in (*required, *_MESHOPT)]:
        yield f"of glTF, {', '.join(others)} is not followed"
    modes = [each.get("mode", 4) for mesh in document.get("meshes", []) for each in mesh["primitives"]]
    if num_left_out := sum(mode in _NO_SURFACE for mode in modes):
        yield f"{num_left_out} of its {len(modes)} surfaces are points or lines and are left out"
    nodes = document.get("nodes", [])
    if any("skin" in node for node in nodes):
        yield "its skin is drawn as the joints stand in the file"
    if any(any(each.get("weights") or ()) for each in (*nodes, *document.get("meshes", []))):
        yield "its morph targets are drawn with the weights that the file gives"


def _names(document: Document, key: str) -> list[str]:
    names = document.get(key)
    return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _is_followed(name: str) -> bool:
    return name in _UNDERSTOOD or name.startswith(_OF_LOOKS)


def _is_all_that_there_is(name: str, document: Document) -> bool:
    """Whether a view's bytes are there in the extension's form alone: its buffer stands for no bytes."""
    buffers = document.get("buffers", [])
    views = [view for view in document.get("bufferViews", []) if name in view.get("extensions", {})]
    return any(
        "uri" not in buffers[view["buffer"]]
        and (view["buffer"] > 0 or name in buffers[0].get("extensions", {}))
        for view in views
    )
