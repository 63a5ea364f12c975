"""One object alone as an MJCF file: parts inline, surfaces by relative path."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from cluttergen_jax.assets.mjcf import VISUAL_GROUP, add_object, add_texture, new_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig


def object_xml(
    asset: ObjectAsset, surfaces: tuple[str, ...], files: Mapping[str, bytes], images: str = ""
) -> bytes:
    """MJCF text of a free body called after the object, with default contact parameters.

    Args:
      asset: the object.
      surfaces: the name of each piece's OBJ file, relative to where the text will be saved.
      files: their contents, by name.
      images: where the images of the surfaces will lie, relative to the text; beside it if empty.
    """
    spec = new_spec(StabilityConfig().timestep, ContactConfig())
    spec.modelname = asset.name
    body = add_object(spec, asset, asset.name)
    spec.worldbody.add_light(pos=(0, 0, 2), dir=(0, 0, -1))
    for index, (piece, surface) in enumerate(zip(asset.pieces, surfaces, strict=True)):
        mesh = spec.add_mesh(name=f"{asset.name}/visual-{index}", file=surface)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            rgba=piece.rgba,
            material=add_texture(spec, piece.texture, images),
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
            mass=0,
        )
    spec.assets = {**spec.assets, **{name: files[name] for name in surfaces}}
    spec.compile()
    return spec.to_xml().encode()
