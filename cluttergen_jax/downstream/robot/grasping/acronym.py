"""Labels of objects as ACRONYM has them, and with their contacts as Contact-GraspNet trains on them.

Eppner et al., "ACRONYM: A Large-Scale Grasp Dataset Based on Simulation", ICRA 2021, and `acronym_tools`;
Sundermeyer et al., "Contact-GraspNet", ICRA 2021, and its code. Their frame of a grasp is the root of the
Panda's hand: z the approach, x the direction in which the fingers close, the middle of the pads `DEPTH` ahead
of it. Any other hand is put so that the middle of its open pads is there.

meshes/KIND/ID.obj              one mesh of each object, as small as its vertices allow
grasps/KIND_ID_1.0.h5           ACRONYM's file of an object
splits/KIND.json                which objects are for training: all
mesh_contacts/KIND_ID_1.0.npz   of Contact-GraspNet: the grasps that have two contacts
scene_contacts/NUMBER.npz       and those that are free in a scene
scene_views/NUMBER_VIEW.npz     depth and colours of the scene, as its inference reads them
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets import ObjectAsset
from cluttergen_jax.downstream.robot.grasping.arrays import write_npz
from cluttergen_jax.downstream.robot.grasping.object_labels import ObjectLabels, sliding_friction
from cluttergen_jax.downstream.transforms import inverse, matrix_of, rigid, shift_along
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.scene import Scene

DEPTH = 0.1034
"""Metres from the root of the Panda's hand to the middle of its pads."""
SCALE = 1.0
"""Meshes are in metres."""
TABLE_TOP = 0.3
"""Metres: Contact-GraspNet's table, a box of 1 x 1.2 x 0.6 m, has its middle at the origin."""
# x of the grasp along y of the tool.
_TURN = rigid(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.zeros(3))
_SUPPORT_KIND = "Support"


@dataclass(frozen=True)
class FileNames:
    """Names of an object's files: their tools cut them at `_`, so no part of them has one.

    Attributes:
      kind: its category. id: unique in it.
    """

    kind: str
    id: str

    @property
    def mesh(self) -> str:
        """From the root of the files."""
        return f"meshes/{self.kind}/{self.id}.obj"

    @property
    def stem(self) -> str:
        """Of the files of grasps and of contacts."""
        return f"{self.kind}_{self.id}_{SCALE}"


def file_names(objects: Sequence[ObjectAsset]) -> dict[str, FileNames]:
    """The files' names of objects, by their own names."""
    found: dict[str, FileNames] = {}
    used = set[str]()
    for asset in objects:
        kind = "".join(word.capitalize() for word in _words(asset.label)) or "Object"
        name = "-".join(_words(asset.name)) or "object"
        given = name
        number = 2
        while given in used:
            given = f"{name}-{number}"
            number += 1
        used.add(given)
        found[asset.name] = FileNames(kind, given)
    return found


def _words(text: str) -> list[str]:
    plain = "".join(each if each.isascii() and each.isalnum() else " " for each in text)
    return plain.split()


def grasp_frame(pose: np.ndarray) -> np.ndarray:
    """f64[..., 4, 4]: their grasps where the open pads' middle is at f64[..., 4, 4], axes as a tool's."""
    return shift_along(pose, (0.0, 0.0, -DEPTH)) @ _TURN


def check_installed() -> None:
    """Raises MissingExtraError where HDF5 cannot be written."""
    try:
        import h5py  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("record", "the format acronym") from error


def write_grasps(
    root: Path, names: FileNames, asset: ObjectAsset, labels: ObjectLabels, hand: Mapping[str, Any]
) -> None:
    """Writes ACRONYM's file of an object.

    Args:
      hand: `type`, the gripper's name; `configuration`, f[k], of its joints, open; `opening`, metres.
    """
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:

        def put(name: str, value: Any) -> None:
            file.create_dataset(name, data=value, track_times=False)

        put("grasps/transforms", grasp_frame(labels.pads))
        flex = "grasps/qualities/flex"
        put(f"{flex}/object_in_gripper", labels.is_held.astype(np.int64))
        put(f"{flex}/object_motion_during_closing_linear", labels.shift)
        put(f"{flex}/object_motion_during_shaking_linear", labels.slip)
        put(f"{flex}/object_motion_during_shaking_angular", labels.turn)
        own = "grasps/qualities/cluttergen"
        put(f"{own}/is_free", labels.is_free.astype(np.int64))
        put(f"{own}/force_closure", labels.is_force_closure.astype(np.int64))
        put(f"{own}/friction", labels.friction)
        put(f"{own}/load", labels.margin)
        put(f"{own}/width", np.linalg.norm(labels.points[:, 0] - labels.points[:, 1], axis=1))
        put("gripper/type", hand["type"])
        put("gripper/configuration", np.asarray(hand["configuration"], np.float64))
        put("gripper/opening", float(hand["opening"]))
        put("object/file", names.mesh)
        put("object/scale", SCALE)
        put("object/mass", asset.mass)
        put("object/com", np.asarray(asset.center_of_mass, np.float64))
        put("object/inertia", np.asarray(asset.inertia, np.float64))
        put("object/friction", float(sliding_friction(asset)))
        volume = sum(part.hull().volume for part in asset.parts)
        put("object/volume", volume)
        put("object/density", asset.mass / volume)
    write_atomically(root / f"grasps/{names.stem}.h5", buffer.getvalue())


def write_splits(root: Path, names: Sequence[FileNames]) -> None:
    """Writes which objects are for training, a file of each category."""
    kinds: dict[str, list[str]] = {}
    for each in names:
        kinds.setdefault(each.kind, []).append(f"{each.stem}.json")
    for kind, stems in kinds.items():
        text = json.dumps({"train": sorted(stems), "test": []}, indent=1) + "\n"
        write_atomically(root / f"splits/{kind}.json", text.encode())


def contact_rows(labels: ObjectLabels) -> np.ndarray:
    """i[N]: the grasps that Contact-GraspNet's tool keeps, those with two contacts."""
    return np.flatnonzero(np.isfinite(labels.friction))


def write_mesh_contacts(
    root: Path, names: FileNames, labels: ObjectLabels, mean: np.ndarray, opening: float
) -> None:
    """Writes the contacts of an object's grasps, about the mean of its mesh f64[3].

    Args:
      opening: metres between the pads, open.
    """
    rows = contact_rows(labels)
    axis = labels.pads[rows, :3, 1]
    middle = labels.pads[rows, :3, 3]
    directions = np.stack([-axis, axis], axis=1)
    starts = middle[:, None] - directions * opening / 2
    points = labels.points[rows]
    grasps = grasp_frame(labels.pads[rows])
    grasps[:, :3, 3] -= mean
    write_npz(
        root / f"mesh_contacts/{names.stem}.npz",
        collisions=np.zeros(len(rows), np.int64),
        valid_locations=np.ones(len(rows), np.int64),
        successful=labels.is_held[rows].astype(np.int64),
        grasp_transform=grasps,
        contact_points=points - mean,
        contact_directions=directions,
        contact_face_normals=labels.normals[rows],
        contact_offsets=np.linalg.norm(points - starts, axis=2),
    )


@dataclass(frozen=True, eq=False)
class ContactScene:
    """What is free in a scene of K objects.

    Attributes:
      T_contact_world: f64[4, 4], to the frame of Contact-GraspNet's table (`contact_frame`).
      held: of each object the rows of its labels that are held and have two contacts, i[S_k].
      is_free: of each object which of these are free in the scene, bool[S_k].
    """

    T_contact_world: np.ndarray
    held: Sequence[np.ndarray]
    is_free: Sequence[np.ndarray]


def contact_frame(T_world_table: np.ndarray) -> np.ndarray:
    """f64[4, 4]: T_contact_world, the table's top (`T_world_table`, z up) at `TABLE_TOP`."""
    return rigid(np.eye(3), np.array([0.0, 0.0, TABLE_TOP])) @ inverse(T_world_table)


def write_scene_contacts(
    root: Path,
    scene: Scene,
    names: Mapping[str, FileNames],
    means: Mapping[str, np.ndarray],
    labels: Mapping[str, ObjectLabels],
    found: ContactScene,
    support: tuple[FileNames, np.ndarray] | None,
) -> None:
    """Writes the grasps that are free in a scene, with their contacts.

    Args:
      support: names and mean of the mesh of a support that is more than a plane: one more object, the last,
        without grasps.
    """
    grasps = []
    contacts = []
    ends = []
    paths = []
    transforms = []
    for row, asset in enumerate(scene.objects):
        T = found.T_contact_world @ matrix_of(scene.poses[row])
        mean = means[asset.name]
        chosen = found.held[row][found.is_free[row]]
        label = labels[asset.name]
        grasps.append(T @ grasp_frame(label.pads[chosen]))
        contacts.append(label.points[chosen] @ T[:3, :3].T + T[:3, 3])
        ends.append(sum(len(each) for each in grasps))
        paths.append(names[asset.name].mesh)
        transforms.append(shift_along(T, mean))
    if support is not None:
        paths.append(support[0].mesh)
        transforms.append(shift_along(found.T_contact_world, support[1]))
        ends.append(ends[-1] if ends else 0)
    write_npz(
        root / f"scene_contacts/{scene.origin.index:06d}.npz",
        obj_paths=np.array(paths),
        obj_transforms=np.array(transforms),
        obj_scales=np.full(len(paths), SCALE),
        grasp_transforms=np.concatenate(grasps).reshape(-1, 4, 4),
        scene_contact_points=np.concatenate(contacts).reshape(-1, 2, 3),
        obj_grasp_idcs=np.array(ends),
        # Not read by their code: of the grasps that are held alone, object by object, which are free here.
        collision_free=np.concatenate([np.zeros(0, bool), *found.is_free]),
    )


def write_view(
    root: Path, stem: str, depth: np.ndarray, rgb: np.ndarray, label: np.ndarray, **cameras: Any
) -> None:
    """Writes what `load_available_input_data` reads: metres, 0 where nothing was measured.

    Of the colours blue comes first, as they read them.
    """
    write_npz(
        root / f"scene_views/{stem}.npz",
        depth=depth.astype(np.float32),
        rgb=np.ascontiguousarray(rgb[..., ::-1]),
        segmap=label.astype(np.int32),
        **cameras,
    )


def support_names(name: str) -> FileNames:
    """The files' names of a support."""
    return FileNames(_SUPPORT_KIND, "-".join(_words(name)) or "support")
