"""The slab of `textured` with a finish, polished brass with a map of normals, and files that say so."""

import io
import json
from dataclasses import replace

import numpy as np
from PIL import Image

from cluttergen_jax.assets.finish import Finish
from cluttergen_jax.assets.shape import Texture
from cluttergen_jax.importing.readers.gltf import glb
from tests.helpers import textured

BRASS = (0.9, 0.7, 0.3, 1.0)
"""sRGB."""


def bumps(side=32):
    """A map of normals that lean right in its right half, left in the other: sines of 0.6."""
    normals = np.zeros((side, side, 3))
    normals[..., 0] = np.where(np.arange(side) < side // 2, -0.6, 0.6)
    normals[..., 2] = 0.8
    return Image.fromarray(np.rint((normals + 1) * 127.5).astype(np.uint8))


def gloss(roughness=0.5, metallic=1.0, side=16):
    """A map of roughness in green and metalness in blue; red is what nobody is to read."""
    pixel = (7, round(255 * roughness), round(255 * metallic))
    return Image.new("RGB", (side, side), pixel)


FINISH = Finish(0.1, 1.0, 0.0, Texture.of(bumps()), None)


def asset(name="slab", has_image=True, **changes):
    """The slab as a body, made by hand, with this finish."""
    piece = textured.piece()
    finish = replace(FINISH, **changes)
    texture = piece.texture if has_image else None
    uv = piece.uv if has_image or finish.images else None
    return textured.asset(name, replace(piece, rgba=BRASS, uv=uv, texture=texture, finish=finish))


def write_glb(path, material, images=(), with_uv=True, **document):
    """The slab as GLB with one material; images are its textures, by number."""
    vertices, faces, uv = textured.slab()
    arrays = [
        (vertices[:, [0, 2, 1]] * [1, 1, -1]).astype("<f4"),
        faces.astype("<u4").reshape(-1, 1),
        (uv * [1, -1] + [0, 1]).astype("<f4"),
    ]
    blobs = [each.tobytes() for each in arrays]
    blobs += [each if isinstance(each, bytes) else textured.png(each) for each in images]
    views = []
    binary = b""
    for blob in blobs:
        binary += b"\0" * (-len(binary) % 4)
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(blob)})
        binary += blob
    kinds = (("VEC3", 5126), ("SCALAR", 5125), ("VEC2", 5126))
    accessors = [
        {"bufferView": k, "count": len(array), "type": kind, "componentType": number}
        for k, (array, (kind, number)) in enumerate(zip(arrays, kinds, strict=True))
    ]
    accessors[0] |= {"min": arrays[0].min(0).tolist(), "max": arrays[0].max(0).tolist()}
    attributes = {"POSITION": 0} | ({"TEXCOORD_0": 2} if with_uv else {})
    primitive = {"attributes": attributes, "indices": 1, "material": 0}
    numbers = range(len(images))
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [material],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
        **({"textures": [{"source": k} for k in numbers]} if images else {}),
        **(
            {"images": [{"bufferView": 3 + k, "mimeType": "image/png"} for k in numbers]}
            if images
            else {}
        ),
        **document,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(glb(document, binary))
    return path


def write_obj(folder, *lines, images=()):
    """OBJ with MTL of these lines, and images by name beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "slab.obj").write_text(textured.obj_text())
    (folder / "slab.mtl").write_text("\n".join(["newmtl printed", *lines]) + "\n")
    for name, image in images:
        data = image if isinstance(image, bytes) else textured.png(image)
        (folder / name).write_bytes(data)
    return folder / "slab.obj"


def document_of(path):
    """The JSON of a GLB file."""
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def pixels_of(document, path, texture):
    """u8[H, W, 3]: an image of a GLB file, by the number of its texture."""
    image = document["images"][document["textures"][texture]["source"]]
    view = document["bufferViews"][image["bufferView"]]
    data = path.read_bytes()
    start = 28 + int.from_bytes(data[12:16], "little") + view.get("byteOffset", 0)
    return np.asarray(Image.open(io.BytesIO(data[start : start + view["byteLength"]])))
