"""glTF files made by hand, down to their bytes."""

import base64
import json
import struct

import numpy as np
import trimesh

BOX = trimesh.creation.box((0.1, 0.06, 0.04))
POINTS = BOX.vertices.astype(np.float32)
FACES = BOX.faces.astype(np.uint16)
CODES = {
    "int8": 5120,
    "uint8": 5121,
    "int16": 5122,
    "uint16": 5123,
    "uint32": 5125,
    "float32": 5126,
}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A glTF document with one box, made by hand."""

    def __init__(self):
        self.binary = b""
        self.document = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "accessors": [],
        }
        self.document |= {
            "nodes": [{"mesh": 0}],
            "bufferViews": [],
            "meshes": [{"primitives": [{}]}],
        }
        self.primitive = self.document["meshes"][0]["primitives"][0]
        self.primitive["indices"] = self.add(FACES.reshape(-1, 1))
        self.primitive["attributes"] = {"POSITION": self.add(POINTS)}

    def view(self, array):
        self.binary += b"\0" * (-len(self.binary) % 4)
        data = array.tobytes()
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.document["bufferViews"].append(view)
        self.binary += data
        return len(self.document["bufferViews"]) - 1

    def add(self, array, **more):
        kind = {
            "componentType": CODES[array.dtype.name],
            "type": KINDS[array.shape[1]],
            "count": len(array),
        }
        self.document["accessors"].append({"bufferView": self.view(array), **kind, **more})
        return len(self.document["accessors"]) - 1

    def write(self, path):
        """As GLB, or as GLTF with its buffer beside it or (`inline.gltf`) in it."""
        buffer = {"byteLength": len(self.binary)}
        document = self.document | {"buffers": [buffer]}
        if path.suffix == ".glb":
            text = json.dumps(document).encode()
            text += b" " * (-len(text) % 4)
            chunks = struct.pack("<I4s", len(text), b"JSON") + text
            chunks += struct.pack("<I4s", len(self.binary), b"BIN\0") + self.binary
            path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
            return path
        if path.stem == "inline":
            head = "data:application/octet-stream;base64,"
            buffer["uri"] = head + base64.b64encode(self.binary).decode()
        else:
            path.with_name("the data.bin").write_bytes(self.binary)
            buffer["uri"] = "the%20data.bin"
        path.write_text(json.dumps(document))
        return path


def skinned(folder):
    """A box in `thing.gltf` that has a skin, a morph, a copy, a camera and a sparse accessor."""
    folder.mkdir(parents=True, exist_ok=True)
    gltf = Gltf()
    count = len(POINTS)
    share = np.tile(np.array([[255, 0, 0, 0]], np.uint8), (count, 1))
    attributes = gltf.primitive["attributes"]
    attributes |= {
        "JOINTS_0": gltf.add(np.zeros((count, 4), np.uint8)),
        "WEIGHTS_0": gltf.add(share, normalized=True),
    }
    places = {"bufferView": gltf.view(np.array([[0]], np.uint8)), "componentType": 5121}
    values = {"bufferView": gltf.view(POINTS[:1])}
    gltf.document["accessors"][attributes["POSITION"]]["sparse"] = {
        "count": 1,
        "indices": places,
        "values": values,
    }
    gltf.primitive["targets"] = [{"POSITION": gltf.add(POINTS)}]
    bound = np.eye(4, dtype=np.float32).reshape(1, 16)
    gltf.document["skins"] = [{"joints": [1], "inverseBindMatrices": gltf.add(bound)}]
    copies = {"attributes": {"TRANSLATION": gltf.add(POINTS[:2])}}
    gltf.document["nodes"] = [
        {"mesh": 0, "skin": 0, "weights": [0.5]},
        {"translation": [0.1, 0, 0], "rotation": [0, 0, 0, 1], "children": [2], "camera": 0},
        {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": copies}},
    ]
    gltf.document["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    gltf.document["scenes"] = [{"nodes": [0, 1]}]
    gltf.write(folder / "inline.gltf").rename(folder / "thing.gltf")
