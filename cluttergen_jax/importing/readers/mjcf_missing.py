"""MJCF files of which a picture is missing or cannot be read: compiled without it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import mujoco


def compiled_without_lost_pictures(path: Path) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model of an MJCF file, without the pictures that MuJoCo cannot read, and notes of these.

    Raises:
      ValueError: the file cannot be compiled for another reason.
    """
    try:
        return mujoco.MjModel.from_xml_path(str(path)), ()
    except ValueError:
        if not (lost := _lost(path)):
            raise
    spec = mujoco.MjSpec.from_file(str(path))
    worn = {each for material in spec.materials for each in material.textures}
    _drop(spec, lost)
    told = dict.fromkeys(file for name, file in lost.items() if name in worn)
    notes = (f"the image {file!r} cannot be read: its surface has its material's colour" for file in told)
    return spec.compile(), tuple(notes)


def _lost(path: Path) -> dict[str, str]:
    """The files of the textures that MuJoCo cannot read, by the textures' names."""
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError:
        return {}
    return {name: _file_of(spec.texture(name)) for name in _pictures(spec) if not _is_read(path, name)}


def _pictures(spec: mujoco.MjSpec) -> list[str]:
    """The names of the textures that come from files."""
    return [each.name for each in spec.textures if _file_of(each)]


def _file_of(texture: mujoco.MjsTexture) -> str:
    return next((each for each in (texture.file, *texture.cubefiles) if each), "")


def _is_read(path: Path, name: str) -> bool:
    """Whether MuJoCo can read a picture of the file, asked where all else is left out."""
    spec = mujoco.MjSpec.from_file(str(path))
    for body in list(spec.worldbody.bodies):
        spec.delete(body)
    for thing in [*spec.worldbody.geoms, *spec.meshes, *spec.hfields]:
        spec.delete(thing)
    _drop(spec, [each for each in _pictures(spec) if each != name])
    try:
        spec.compile()
    except ValueError:
        return False
    return True


def _drop(spec: mujoco.MjSpec, names: Iterable[str]) -> None:
    """Takes pictures off all materials, and away."""
    names = set(names)
    for material in spec.materials:
        for role, name in enumerate(material.textures):
            if name in names:
                material.textures[role] = ""
    for texture in [each for each in spec.textures if each.name in names]:
        spec.delete(texture)
