"""Labels in the layout of GraspNet-1Billion, which graspnetAPI reads; of a suction cup SuctionNet-1Billion's.

Fang et al., "GraspNet-1Billion", CVPR 2020; Cao et al., "SuctionNet-1Billion", RA-L 2021. A grasp is a point
of the object, one of 300 views, one of 12 turns about it and one of 4 depths along it; x is the approach, y
the direction in which the fingers close. The middle of the pads is `depth` ahead of the point, where their
code looks for contacts. The score is the least sliding friction with which both contacts can be pressed
towards each other, a multiple of 0.1 up to 1; -1 where there is none, or a pad lies on too little.

models/ID/{nontextured.ply,textured.obj,textured.sdf}
grasp_label/ID_labels.npz, collision_label/SCENE/collision_labels.npz
seal_label/ID_seal.npz, wrench_label/NUMBER_wrench.npz, suction_collision_label/NUMBER_collision.npz
scenes/SCENE/{object_id_list.txt,rs_wrt_kn.npy}
scenes/SCENE/realsense/{rgb,depth,label,meta,annotations}/VIEW, camK.npy, camera_poses.npy, cam0_wrt_table.npy
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import trimesh
from PIL import Image
from scipy.io import savemat

from cluttergen_jax.assets import Mesh, ObjectAsset
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping.arrays import write_mesh, write_npy, write_npz
from cluttergen_jax.downstream.robot.grasping.candidates import HandCheck, Union, pads_cover
from cluttergen_jax.downstream.robot.grasping.object_labels import closing_contacts
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import inverse, matrix_of, pose_of, rigid
from cluttergen_jax.files import write_atomically
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import Camera

NUM_VIEWS = 300
NUM_TURNS = 12
DEPTHS = (0.01, 0.02, 0.03, 0.04)
CAMERA = "realsense"
WIDTH = 1280
HEIGHT = 720
INTRINSICS = ((927.17, 0.0, 651.32), (0.0, 927.37, 349.62), (0.0, 0.0, 1.0))
"""Of their RealSense, whole numbers at the middles of pixels."""
DEPTH_UNIT = 1000.0
"""Depth images have so many steps a metre."""
_STEP = 0.1
_MOST_FRICTION = 1.0
_NONE = -1.0
_SDF_SIDE = 48
_MESH_EDGE = 0.005
"""Metres: their code takes a mesh's vertices for a cloud of its surface."""


class DenseLabels(NamedTuple):
    """Grasps of an object at P points: V views, A turns, D depths.

    Attributes:
      points: f32[P, 3], object frame. offsets: f32[P, V, A, D, 3], turn (radians), depth and width (metres).
      scores: f32[P, V, A, D], the least friction, -1 for none.
      collision: bool[P, V, A, D], the hand, open by the width, touches the object; true too where the score
        is -1, where nobody looks.
      contact_width: f32[P, V, A, D], metres between the contacts, 0 without; the hand opens wider.
    """

    points: np.ndarray
    offsets: np.ndarray
    scores: np.ndarray
    collision: np.ndarray
    contact_width: np.ndarray


def generate_views() -> np.ndarray:
    """f64[V, 3]: directions on a Fibonacci lattice, out of the object; the approach is against them."""
    # In single precision, as theirs: its error in large angles is part of the directions.
    index = np.arange(NUM_VIEWS, dtype=np.float32)
    height = (2 * index + 1) / NUM_VIEWS - 1
    ring = np.sqrt(1 - height**2)
    turn = 2 * index * np.pi * ((np.sqrt(5) - 1) / 2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1).astype(np.float64)


def view_rotations() -> np.ndarray:
    """f64[V, A, 3, 3]: the grasp's axes in the object's frame: approach, closing direction, the third."""
    approach = -generate_views()
    across = np.stack([-approach[:, 1], approach[:, 0], np.zeros(NUM_VIEWS)], axis=1)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(length > 0, across / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    base = np.stack([approach, across, np.cross(approach, across)], axis=-1)
    angle = turn_angles()
    turns = np.zeros((NUM_TURNS, 3, 3))
    turns[:, 0, 0] = 1.0
    turns[:, 1, 1] = turns[:, 2, 2] = np.cos(angle)
    turns[:, 2, 1] = np.sin(angle)
    turns[:, 1, 2] = -np.sin(angle)
    rotations: np.ndarray = base[:, None] @ turns
    return rotations


def turn_angles() -> np.ndarray:
    """f64[A]: radians, half a turn in all: the other half changes nothing."""
    return np.arange(NUM_TURNS) * np.pi / NUM_TURNS


def pad_poses(
    points: np.ndarray, view: np.ndarray, turn: np.ndarray, depth: np.ndarray
) -> np.ndarray:
    """f64[L, 4, 4]: T_object_pads, axes as a tool's, of grasps: points f[L, 3], numbers i[L] of the others.

    The origin is the middle of the pads once they touch: a tool is `Gripper.depth_of` behind it.
    """
    axes = view_rotations()[view, turn]
    # z the approach, y the closing direction.
    turned = np.stack([-axes[..., 2], axes[..., 1], axes[..., 0]], axis=-1)
    ahead = np.array(DEPTHS)[depth]
    return rigid(turned, points + ahead[:, None] * axes[..., 0])


def tool_poses(pads: np.ndarray, width: np.ndarray, robot: RobotDescription) -> np.ndarray:
    """f64[L, 4, 4]: T_object_tool where the pads' middle is at f64[L, 4, 4] once they are f64[L] apart.

    A jaw that stands still keeps off what the hand comes to (`Gripper.shift_of`).
    """
    gripper = gripper_of(robot)
    tools = pads.copy()
    tools[:, :3, 3] -= gripper.depth_of(width)[:, None] * pads[:, :3, 2]
    tools[:, :3, 3] -= gripper.shift_of(width)[:, None] * pads[:, :3, 1]
    return tools


def label_densely(asset: ObjectAsset, number: int, robot: RobotDescription) -> DenseLabels:
    """Scores all grasps at `number` points of an object for the hand of a robot."""
    gripper = gripper_of(robot)
    union = Union(asset.parts)
    points = np.unique(asset.cloud[:number], axis=0).astype(np.float64)
    shape = (len(points), NUM_VIEWS, NUM_TURNS, len(DEPTHS))
    point, view, turn, depth = (each.ravel() for each in np.indices(shape))
    axes = view_rotations()[view, turn]
    middle = points[point] + np.array(DEPTHS)[depth][:, None] * axes[..., 0]
    contacts = closing_contacts(union, middle, axes[..., 1], gripper.max_opening)
    friction = np.maximum(np.ceil(contacts.friction / _STEP - 1e-6), 1) * _STEP
    is_good = friction <= _MOST_FRICTION + 1e-6
    rows = np.flatnonzero(is_good)
    is_good[rows] = pads_cover(
        union,
        contacts.points[rows, 1],
        axes[rows, :, 1],
        axes[rows, :, 0],
        robot.gripper.pad,
    )
    width = np.where(is_good, 2 * gripper.opening_of(contacts.width), 2 * gripper.max_opening)
    hand = HandCheck(asset, robot)
    collision = np.ones(len(point), bool)
    rows = np.flatnonzero(is_good)
    wide = contacts.width[rows]
    poses = pad_poses(points[point[rows]], view[rows], turn[rows], depth[rows])
    tools = tool_poses(poses, wide, robot)
    collision[rows] = [not hand.is_clear_at(*each) for each in zip(tools, wide, strict=True)]
    offsets = np.stack([turn_angles()[turn], np.array(DEPTHS)[depth], width], axis=-1)
    return DenseLabels(
        points.astype(np.float32),
        offsets.reshape(*shape, 3).astype(np.float32),
        np.where(is_good, friction, _NONE).reshape(shape).astype(np.float32),
        collision.reshape(shape),
        np.where(is_good, contacts.width, 0.0).reshape(shape).astype(np.float32),
    )


def write_model(root: Path, number: int, asset: ObjectAsset, surface: Mesh) -> None:
    """Writes the meshes of an object and its signed distances, negative inside, by its collision parts."""
    folder = root / f"models/{number:03d}"
    merged = trimesh.Trimesh(surface.vertices, surface.faces, process=True)
    vertices, faces = trimesh.remesh.subdivide_to_size(
        merged.vertices, merged.faces, _MESH_EDGE, max_iter=12
    )
    fine = trimesh.Trimesh(vertices, faces, process=True)
    ply = trimesh.exchange.ply.export_ply(fine)
    write_atomically(folder / "nontextured.ply", ply)
    write_mesh(folder / "textured.obj", surface)
    write_atomically(folder / "textured.sdf", _sdf_text(asset, surface).encode())


def _sdf_text(asset: ObjectAsset, surface: Mesh) -> str:
    lower, upper = surface.bounds
    step = float((upper - lower).max()) / (_SDF_SIDE - 9)
    origin = (lower + upper) / 2 - step * (_SDF_SIDE - 1) / 2
    index = np.arange(_SDF_SIDE)
    # x runs fastest.
    z, y, x = np.meshgrid(index, index, index, indexing="ij")
    points = origin + step * np.stack([x, y, z], axis=-1).reshape(-1, 3)
    distance = Union(asset.parts).distance(points)
    head = [f"{_SDF_SIDE} {_SDF_SIDE} {_SDF_SIDE}", " ".join(f"{each:.6g}" for each in origin)]
    return "\n".join([*head, f"{step:.6g}", *(f"{each:.6g}" for each in distance)]) + "\n"


def write_labels(root: Path, number: int, labels: DenseLabels, simulated: np.ndarray) -> None:
    """Writes the grasps of an object.

    Args:
      simulated: i8[P, V, A, D], 1 where it held in simulation, 0 where it did not, -1 where it was not tried.
        graspnetAPI does not read it.
    """
    write_npz(
        root / f"grasp_label/{number:03d}_labels.npz", **labels._asdict(), simulated=simulated
    )


def write_collisions(root: Path, number: int, masks: Sequence[np.ndarray]) -> None:
    """Writes which grasps of the objects of a scene touch something there, bool[P, V, A, D] each."""
    write_npz(
        root / f"collision_label/{scene_name(number)}/collision_labels.npz",
        **{f"arr_{k}": each for k, each in enumerate(masks)},
    )


def scene_name(number: int) -> str:
    """The folder of a scene."""
    return f"scene_{number:04d}"


def cameras_at(poses: Sequence[np.ndarray]) -> list[Camera]:
    """Their camera at T_world_camera f64[4, 4] each; `Camera` has halves at the middles of pixels."""
    K = np.array(INTRINSICS)
    K[:2, 2] += 0.5
    return [Camera(WIDTH, HEIGHT, K, each) for each in poses]


def write_scene(
    root: Path,
    number: int,
    scene: Scene,
    ids: Sequence[int],
    T_world_table: np.ndarray,
    cameras: Sequence[Camera],
) -> None:
    """Writes what is told of a scene, but for its images; ids: of its objects, one of each model."""
    folder = root / "scenes" / scene_name(number)
    place = folder / CAMERA
    write_atomically(folder / "object_id_list.txt", "".join(f"{each}\n" for each in ids).encode())
    write_npy(folder / "rs_wrt_kn.npy", np.eye(4))
    first = cameras[0].T_world_camera
    write_npy(place / "camK.npy", np.array(INTRINSICS))
    write_npy(place / "cam0_wrt_table.npy", inverse(T_world_table) @ first)
    write_npy(
        place / "camera_poses.npy",
        np.stack([inverse(first) @ each.T_world_camera for each in cameras]),
    )
    for view, camera in enumerate(cameras):
        poses = inverse(camera.T_world_camera) @ matrix_of(scene.poses)
        names = [asset.name for asset in scene.objects]
        write_atomically(place / f"annotations/{view:04d}.xml", _annotation(ids, names, poses))
        buffer = io.BytesIO()
        savemat(
            buffer,
            {
                "cls_indexes": np.array(ids, np.int32)[None] + 1,
                "poses": np.moveaxis(poses[:, :3], 0, -1),
                "intrinsic_matrix": np.array(INTRINSICS),
                "factor_depth": np.array([[DEPTH_UNIT]]),
            },
        )
        # The file's first line tells when it was written.
        data = b"MATLAB 5.0 MAT-file".ljust(116) + buffer.getvalue()[116:]
        write_atomically(place / f"meta/{view:04d}.mat", data)


def _annotation(ids: Sequence[int], names: Sequence[str], poses: np.ndarray) -> bytes:
    top = ElementTree.Element("scene")
    for number, name, pose in zip(ids, names, pose_of(poses), strict=True):
        entry = ElementTree.SubElement(top, "obj")
        texts = {
            "obj_id": str(number),
            "obj_name": name,
            "obj_path": f"models/{number:03d}/nontextured.ply",
            "pos_in_world": " ".join(f"{each:.9f}" for each in pose[:3]),
            "ori_in_world": " ".join(f"{each:.9f}" for each in pose[3:]),
        }
        for tag, text in texts.items():
            ElementTree.SubElement(entry, tag).text = text
    ElementTree.indent(top)
    return ElementTree.tostring(top) + b"\n"


def write_images(
    root: Path, number: int, view: int, rgb: np.ndarray, depth: np.ndarray, label: np.ndarray
) -> None:
    """Writes the images of a view.

    Args:
      rgb: u8[H, W, 3]. depth: f[H, W], metres, not finite where nothing was measured.
      label: i[H, W], 1 + the object's id, 0 elsewhere.
    """
    place = root / "scenes" / scene_name(number) / CAMERA
    steps = np.round(np.where(np.isfinite(depth), depth, 0.0) * DEPTH_UNIT)
    kind = np.uint8 if label.max(initial=0) < 256 else np.uint16
    for name, image in (
        ("rgb", rgb),
        ("depth", np.clip(steps, 0, 65535).astype(np.uint16)),
        ("label", label.astype(kind)),
    ):
        buffer = io.BytesIO()
        Image.fromarray(image).save(buffer, "PNG")
        write_atomically(place / f"{name}/{view:04d}.png", buffer.getvalue())
