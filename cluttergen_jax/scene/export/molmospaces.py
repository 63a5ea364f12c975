"""MolmoSpaces: objects as a user's asset library, what each scene's metadata say, and grasps beside objects.

Its conventions (docs/tutorials/custom_assets.md of version 0.2): UID/UID.xml with one body, UID/UID.json, a
scene NAME.xml with NAME_metadata.json, and UID/ROBOT/grasps.npz with `transforms` f[N, 4, 4] in the body's
frame; the gripper's z points forward and its fingers open along y, as our tool frame does.
"""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import rotation_matrix
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.shapes import category
from cluttergen_jax.schema import Numbers, check_numbers, read_sealed_parquet

# Whose hand the grasps were tested with: what MolmoSpaces calls it, and what a file of grasps does.
ROBOT = "franka"
HAND = "panda"

_SHORT = ("one_word", "two_words", "three_words", "four_words", "five_words")
_PREPOSITION = re.compile(" (?:in|of|on|for|with) ")
_POSES = {"pose": Numbers("f8", ("grasps", 7), -10, 10)}


def asset_json(asset: ObjectAsset) -> bytes:
    """An object's entry of the library; a synset only if the object came with one of WordNet."""
    points = [mesh.vertices for mesh in (*asset.parts, *(piece.mesh for piece in asset.pieces))]
    thing = f"{'an' if asset.label[:1] in 'aeiou' else 'a'} {asset.label}"
    words = asset.label.split()
    head = _PREPOSITION.split(asset.label)[0].split()
    record = {
        "assetId": asset.name,
        "category": category(asset),
        "description_long": f"This is {thing}.",
        "description": f"{thing.capitalize()}.",
        "description_short": {
            name: " ".join(head[-size:] if size < len(words) else words)
            for size, name in enumerate(_SHORT, 1)
        },
        "mass": float(asset.mass),
        "boundingBox": dict(
            zip("xyz", (2 * np.abs(np.concatenate(points)).max(0)).tolist(), strict=True)
        ),
        **({"synset": asset.synset} if asset.synset.count(".") == 2 else {}),
    }
    return (json.dumps(record, indent=1) + "\n").encode()


def scene_metadata(scene: Scene) -> bytes:
    """Which asset each body of a scene is."""
    objects = {
        name: {
            "asset_id": asset.name,
            "object_id": name,
            "category": category(asset),
            "is_static": False,
        }
        for name, asset in zip(scene.names, scene.objects, strict=True)
    }
    return (json.dumps({"objects": objects}, indent=1) + "\n").encode()


def read_grasps(path: str | Path) -> dict[str, np.ndarray]:
    """Grasps in a file of `cluttergen robot grasps --out`: f64[G, 4, 4], T_object_tool, by the object's hash.

    Raises:
      ConfigError: there is no such file, it is damaged, or its grasps are of another hand than a Panda's.
    """
    allowed = "a file of `cluttergen robot grasps POOL --out grasps.parquet`, of the Panda's hand"
    try:
        table = read_sealed_parquet(Path(path).read_bytes())
        poses = np.array(table["pose"].to_pylist(), np.float64).reshape(-1, 7)
        check_numbers({"pose": poses}, _POSES)
        hashes = np.array(table["hash"].to_pylist())
        if (np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) > 1e-3).any():
            raise ValueError("a quaternion is not of unit length")
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as error:
        raise ConfigError(f"grasps {str(path)!r}: {error}", allowed) from error
    hand = (table.schema.metadata or {}).get(b"hand", b"").decode()
    if hand != HAND:
        whose = "another hand" if hand else "a hand that it does not name"
        raise ConfigError(
            f"grasps {str(path)!r}, tested with {whose}", allowed, "making them again"
        )
    transforms = np.tile(np.eye(4), (len(poses), 1, 1))
    transforms[:, :3, 3] = poses[:, :3]
    transforms[:, :3, :3] = np.array([rotation_matrix(each) for each in poses[:, 3:]]).reshape(
        -1, 3, 3
    )
    return {str(each): transforms[hashes == each] for each in np.unique(hashes)}


def write_grasps(folder: Path, transforms: np.ndarray) -> None:
    """Writes the grasps of the object whose folder is `folder`."""
    (folder / ROBOT).mkdir()
    buffer = io.BytesIO()
    np.savez(buffer, transforms=transforms)
    (folder / ROBOT / "grasps.npz").write_bytes(buffer.getvalue())
