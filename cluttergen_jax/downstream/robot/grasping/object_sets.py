"""The formats that label objects one by one, and scenes by them: ACRONYM, Contact-GraspNet, GraspNet.

An object is labelled once for all of them; a scene then tells which of its grasps are free there.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mujoco.rollout import Rollout

from cluttergen_jax.assets import Mesh, ObjectAsset, SupportAsset, join_meshes
from cluttergen_jax.downstream.noise import REALSENSE, noisy
from cluttergen_jax.downstream.robot.description import RobotDescription
from cluttergen_jax.downstream.robot.grasping import acronym, graspnet
from cluttergen_jax.downstream.robot.grasping.arrays import write_mesh, write_npz
from cluttergen_jax.downstream.robot.grasping.candidates import GraspCandidates, Union
from cluttergen_jax.downstream.robot.grasping.clutter import StillScene
from cluttergen_jax.downstream.robot.grasping.grasp_check import check_grasps
from cluttergen_jax.downstream.robot.grasping.object_labels import (
    ObjectLabels,
    label_object,
    sliding_friction,
)
from cluttergen_jax.downstream.robot.grasping.suction import (
    STRETCH,
    Hand,
    StillCups,
    SuctionCup,
    facing_poses,
    gravity_load,
    label_cups,
    rim_stretch,
    surface_poses,
)
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.transforms import matrix_of, rigid
from cluttergen_jax.files import write_atomically
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.progress import Progress
from cluttergen_jax.rendering import (
    PictureConfig,
    RenderStyle,
    close_points,
    open_scene_renderer,
)
from cluttergen_jax.scene import Scene
from cluttergen_jax.sensing import FIRST_OBJECT, Camera, RaySensor, sensed_model

ACRONYM_FOLDER = "acronym"
GRASPNET_FOLDER = "graspnet"
SEEN = ("contact_graspnet", "graspnet")
"""Formats with pictures."""
BY_OBJECT = ("acronym", *SEEN)
"""Formats that label objects."""
GRASPS_A_POINT = 100
"""GraspNet's 14400 grasps at a point count as so many of `num_object_grasps`."""
_LEAST_POINTS = 8
_SIMULATED = 64
"""Of GraspNet's grasps of an object that are good by their contacts, so many are simulated."""
_NEAREST = 0.45
"""Metres of a camera from the middle of the objects."""
# Times the distance from which all of them are in the picture; radians from the vertical.
_FARTHER = (1.0, 1.4)
_TILTS = (0.1, np.pi / 4)
_SAMPLES = 4
_LEVEL = 0.002
# Of Contact-GraspNet's pictures: pixels, whole numbers at their middles.
_CONTACT_SIZE = (640, 480)
_CONTACT_K = ((616.36529541, 0, 310.25881958), (0, 616.20294189, 236.59980774), (0, 0, 1.0))


@dataclass(frozen=True, eq=False)
class _Dense:
    """What scenes need of an object's dense labels: which are good, where the tool is, and how wide.

    Attributes:
      shape: of all of them. rows: i[N], of the good ones, flat. pose: f64[N, 4, 4], T_object_tool.
      width: f64[N], metres between the contacts.
    """

    shape: tuple[int, ...]
    rows: np.ndarray
    pose: np.ndarray
    width: np.ndarray


class ObjectSets:
    """Writes what formats need of objects and of scenes, each file once; what is there is read.

    Args:
      out: the dataset's folder. objects: of all scenes, once each. formats: those asked for.
      hand: that holds. number: of each object's grasps. views: of a scene. noise: factor of a depth camera's.
    """

    def __init__(
        self,
        out: Path,
        objects: Sequence[ObjectAsset],
        formats: Sequence[str],
        hand: Hand,
        number: int,
        views: int,
        noise: float,
        seed: int,
    ) -> None:
        self.objects = tuple(objects)
        self.names = acronym.file_names(objects)
        self.ids = {asset.name: index for index, asset in enumerate(objects)}
        self.labels: dict[str, ObjectLabels] = {}
        self.simulated: list[np.ndarray] = []
        self._out = out
        self._formats = frozenset(formats)
        self._hand = hand
        self._number = number
        self._views = views
        self._noise = noise
        self._seed = seed
        self._means: dict[str, np.ndarray] = {}
        self._dense: dict[str, _Dense] = {}

    @property
    def has_acronym(self) -> bool:
        """Whether ACRONYM's files are written: Contact-GraspNet's tools read them as well."""
        return not self._formats.isdisjoint(("acronym", "contact_graspnet"))

    @property
    def num_points(self) -> int:
        """Of GraspNet's labels, on each object."""
        return max(_LEAST_POINTS, self._number // GRASPS_A_POINT)

    def make_objects(self, surface_of: Callable[[ObjectAsset], Mesh], num_threads: int) -> None:
        """Labels the objects, one after the other, and writes their files."""
        if self._formats.isdisjoint(BY_OBJECT):
            return
        known = [asset for asset in self.objects if self._part(asset).is_file()]
        with (
            Progress("labels", len(self.objects), "object", len(known)) as progress,
            Rollout(nthread=num_threads or os.cpu_count() or 1) as pool,
        ):
            for asset in self.objects:
                is_new = not self._part(asset).is_file()
                if is_new:
                    self._make_object(asset, surface_of(asset), pool)
                self._read_object(asset)
                if is_new:
                    held = int(self.labels[asset.name].is_held.sum())
                    progress.update(
                        1, f"{held} of {len(self.labels[asset.name].pose)} hold {asset.name}"
                    )
        if self.has_acronym:
            acronym.write_splits(self._root(ACRONYM_FOLDER), list(self.names.values()))

    @property
    def lacking(self) -> list[str]:
        """The objects of which no grasp holds."""
        return [name for name, labels in self.labels.items() if not labels.is_held.any()]

    def make_scene(self, scene: Scene, still: StillScene | StillCups) -> None:
        """Writes which of its objects' grasps are free in a scene."""
        if "contact_graspnet" in self._formats:
            self._write_contacts(scene, still)
        if "graspnet" in self._formats and isinstance(self._hand, SuctionCup):
            self._write_suctions(scene, still, self._hand)
        elif "graspnet" in self._formats:
            graspnet.write_collisions(
                self._root(GRASPNET_FOLDER),
                scene.origin.index,
                [self._masks(scene, row, still) for row in range(len(scene.objects))],
            )

    def draw_scenes(self, scenes: Sequence[Scene]) -> None:
        """Draws what cameras see of scenes, one after the other.

        Raises:
          RendererError: nothing here can draw.
        """
        if self._formats.isdisjoint(SEEN):
            return
        missing = [scene for scene in scenes if not self._pictures_marker(scene).is_file()]
        with Progress("pictures", len(scenes), "scene", len(scenes) - len(missing)) as progress:
            for scene in missing:
                self._draw_scene(scene)
                write_atomically(self._pictures_marker(scene), b"")
                progress.update(1)

    def _root(self, folder: str) -> Path:
        return self._out / folder

    def _part(self, asset: ObjectAsset) -> Path:
        return self._out / f"parts/objects/{asset.name}.npz"

    def _pictures_marker(self, scene: Scene) -> Path:
        """An empty file, written once the pictures of a scene are complete."""
        return self._out / f"parts/{scene.origin.index:06d}.seen"

    def _opening(self) -> float:
        """Metres between the pads, open; across the rim of a cup."""
        if isinstance(self._hand, SuctionCup):
            return 2 * self._hand.radius
        return 2 * gripper_of(self._hand).max_opening

    def _make_object(self, asset: ObjectAsset, surface: Mesh, pool: Rollout) -> None:
        """Writes all files of an object, its own labels last."""
        hand = self._hand
        names = self.names[asset.name]
        if isinstance(hand, SuctionCup):
            labels = label_cups(asset, self._number, self._seed, hand)
            joints = np.array([hand.radius])
        else:
            labels = label_object(asset, self._number, self._seed, hand, pool)
            gripper = gripper_of(hand)
            joints = gripper.joints_of(gripper.max_opening)[gripper.driven]
        told = {
            "type": hand.name,
            "configuration": np.unique(joints.round(9)),
            "opening": self._opening(),
        }
        mean = np.zeros(3)
        simulated = np.zeros(0, bool)
        if self.has_acronym:
            root = self._root(ACRONYM_FOLDER)
            mean = write_mesh(root / names.mesh, surface)
            acronym.write_grasps(root, names, asset, labels, told)
            if "contact_graspnet" in self._formats:
                acronym.write_mesh_contacts(root, names, labels, mean, self._opening())
        if "graspnet" in self._formats:
            simulated = self._write_dense(asset, surface, pool)
        write_npz(self._part(asset), mean=mean, simulated=simulated, **labels._asdict())

    def _read_object(self, asset: ObjectAsset) -> None:
        with np.load(self._part(asset), allow_pickle=False) as kept:
            self.labels[asset.name] = ObjectLabels(*(kept[name] for name in ObjectLabels._fields))
            self._means[asset.name] = kept["mean"]
            self.simulated.append(kept["simulated"])

    def _write_dense(self, asset: ObjectAsset, surface: Mesh, pool: Rollout) -> np.ndarray:
        """Writes GraspNet's files of an object; bool[S], of those simulated that should hold which did."""
        root = self._root(GRASPNET_FOLDER)
        number = self.ids[asset.name]
        graspnet.write_model(root, number, asset, surface)
        if isinstance(self._hand, SuctionCup):
            self._write_seals(root, number, asset, self._hand)
            return np.zeros(0, bool)
        labels = graspnet.label_densely(asset, self.num_points, self._hand)
        dense = _dense_of(labels, self._hand)
        rng = np.random.default_rng([self._seed, number, 88])
        tried = np.sort(rng.permutation(len(dense.rows))[:_SIMULATED])
        held = np.zeros(0, bool)
        if len(tried):
            candidates = GraspCandidates(
                dense.pose[tried], dense.width[tried], np.zeros(len(tried), bool)
            )
            held = check_grasps(asset, candidates, pool, robot=self._hand).is_held
        simulated = np.full(labels.scores.size, -1, np.int8)
        simulated[dense.rows[tried]] = held
        graspnet.write_labels(root, number, labels, simulated.reshape(labels.scores.shape))
        # What needs more friction than the object has is not said to hold.
        needed = labels.scores.ravel()[dense.rows[tried]]
        return held[needed <= sliding_friction(asset) + 1e-6]

    def _write_seals(self, root: Path, number: int, asset: ObjectAsset, cup: SuctionCup) -> None:
        rng = np.random.default_rng([self._seed, number, 88])
        union = Union(asset.parts)
        poses = surface_poses(union, self._number, rng)
        score = np.clip(1 - rim_stretch(union, poses, cup) / STRETCH, 0, 1)
        write_npz(
            root / f"seal_label/{number:03d}_seal.npz",
            points=poses[:, :3, 3],
            normals=-poses[:, :3, 2],
            scores=score,
        )

    def _write_suctions(self, scene: Scene, still: StillScene | StillCups, cup: SuctionCup) -> None:
        root = self._root(GRASPNET_FOLDER)
        wrenches = []
        masks = []
        for asset, T in zip(scene.objects, matrix_of(scene.poses), strict=True):
            sealed = root / f"seal_label/{self.ids[asset.name]:03d}_seal.npz"
            with np.load(sealed, allow_pickle=False) as kept:
                points = kept["points"]
                poses = facing_poses(points, -kept["normals"], np.zeros(len(points)))
            load = gravity_load(asset, poses, -T[2, :3], cup)
            wrenches.append(np.clip(1 - load, 0, 1))
            masks.append(np.array([bool(still.blocker(T @ each, 0.0)) for each in poses], bool))
        name = f"{scene.origin.index:04d}"
        for path, arrays in (
            (f"wrench_label/{name}_wrench.npz", wrenches),
            (f"suction_collision_label/{name}_collision.npz", masks),
            # Their loader looks here, their check there.
            (f"collision_label/{name}_collision.npz", masks),
        ):
            write_npz(root / path, **{f"arr_{k}": each for k, each in enumerate(arrays)})

    def _masks(self, scene: Scene, row: int, still: StillScene | StillCups) -> np.ndarray:
        """bool[P, V, A, D]: what touches something in the scene, or is not good by itself."""
        asset = scene.objects[row]
        dense = self._dense_of(asset)
        T = matrix_of(scene.poses[row])
        mask = np.ones(int(np.prod(dense.shape)), bool)
        assert isinstance(still, StillScene)
        poses = T @ dense.pose
        mask[dense.rows] = [
            bool(still.blocker(pose, width, (0.0,)))
            for pose, width in zip(poses, dense.width, strict=True)
        ]
        return mask.reshape(dense.shape)

    def _dense_of(self, asset: ObjectAsset) -> _Dense:
        found = self._dense.get(asset.name)
        if found is None:
            path = (
                self._root(GRASPNET_FOLDER) / f"grasp_label/{self.ids[asset.name]:03d}_labels.npz"
            )
            assert isinstance(self._hand, RobotDescription)
            with np.load(path, allow_pickle=False) as kept:
                labels = graspnet.DenseLabels(
                    *(kept[name] for name in graspnet.DenseLabels._fields)
                )
            found = self._dense[asset.name] = _dense_of(labels, self._hand)
        return found

    def _write_contacts(self, scene: Scene, still: StillScene | StillCups) -> None:
        T_world_table = table_frame(scene.support)
        held = []
        is_free = []
        for asset, T in zip(scene.objects, matrix_of(scene.poses), strict=True):
            labels = self.labels[asset.name]
            rows = acronym.contact_rows(labels)
            rows = rows[labels.is_held[rows]]
            held.append(rows)
            is_free.append(
                np.array(
                    [not still.blocker(T @ labels.pose[k], self._opening()) for k in rows], bool
                )
            )
        acronym.write_scene_contacts(
            self._root(ACRONYM_FOLDER),
            scene,
            self.names,
            self._means,
            self.labels,
            acronym.ContactScene(acronym.contact_frame(T_world_table), held, is_free),
            self._support_mesh(scene.support),
        )

    def _support_mesh(self, support: SupportAsset) -> tuple[acronym.FileNames, np.ndarray] | None:
        """A support that rises above the plane on which objects are: their code knows a table alone."""
        pieces = support.collision_pieces
        if max(piece.mesh.vertices[:, 2].max() for piece in pieces) <= support.lowest + _LEVEL:
            return None
        names = acronym.support_names(support.name)
        mesh = join_meshes([piece.mesh for piece in pieces])
        return names, write_mesh(self._root(ACRONYM_FOLDER) / names.mesh, mesh)

    def _draw_scene(self, scene: Scene) -> None:
        rng = np.random.default_rng([self._seed, scene.origin.index, 89])
        places = draw_places(scene, self._views, rng)
        number = scene.origin.index
        ids = [self.ids[asset.name] for asset in scene.objects]
        noise = REALSENSE.scale(self._noise)
        picture = PictureConfig(graspnet.WIDTH, graspnet.HEIGHT, samples=_SAMPLES)
        T_world_table = table_frame(scene.support)
        T_contact_world = acronym.contact_frame(T_world_table)
        sensor = RaySensor(sensed_model(scene.objects, scene.support))
        data = sensor.make_data()
        sensor.pose(data, scene.poses)
        styles = [RenderStyle(pose) for pose in scene.poses]
        around = close_points(scene.objects, scene.poses, scene.support)
        with open_scene_renderer(scene.objects, scene.support, around, picture) as renderer:
            if "graspnet" in self._formats:
                root = self._root(GRASPNET_FOLDER)
                cameras = graspnet.cameras_at(places)
                graspnet.write_scene(root, number, scene, ids, T_world_table, cameras)
                for view, camera in enumerate(cameras):
                    seen = sensor.sense(data, camera)
                    renderer.camera = camera
                    rgb = renderer.picture(styles)
                    depth = noisy(seen.depth, camera, noise, rng)[0]
                    label_of = np.array([0] * FIRST_OBJECT + [1 + each for each in ids])
                    graspnet.write_images(root, number, view, rgb, depth, label_of[seen.label])
            if "contact_graspnet" in self._formats:
                K = np.array(_CONTACT_K)
                for view, place in enumerate(places):
                    shifted = K.copy()
                    shifted[:2, 2] += 0.5
                    camera = Camera(*_CONTACT_SIZE, shifted, place)
                    seen = sensor.sense(data, camera)
                    renderer.camera = camera
                    rgb = renderer.picture(styles)
                    depth = noisy(seen.depth, camera, noise, rng)[0]
                    acronym.write_view(
                        self._root(ACRONYM_FOLDER),
                        f"{number:06d}_{view:04d}",
                        np.where(np.isfinite(depth), depth, 0.0),
                        rgb,
                        np.maximum(seen.label - FIRST_OBJECT + 1, 0),
                        K=K,
                        camera_pose=T_contact_world @ place,
                    )


def _dense_of(labels: graspnet.DenseLabels, robot: RobotDescription) -> _Dense:
    shape = labels.scores.shape
    rows = np.flatnonzero((labels.scores > 0) & ~labels.collision)
    point, view, turn, depth = np.unravel_index(rows, shape)
    pads = graspnet.pad_poses(labels.points[point].astype(np.float64), view, turn, depth)
    width = labels.contact_width.ravel()[rows].astype(np.float64)
    return _Dense(shape, rows, graspnet.tool_poses(pads, width, robot), width)


def table_frame(support: SupportAsset) -> np.ndarray:
    """f64[4, 4]: T_world_table, at the region's middle on the lowest surface, turned as the region, z up."""
    middle = support.region_points[0]
    return rigid(yaw_matrix(support.region.yaw), np.array([middle[0], middle[1], support.lowest]))


def draw_places(scene: Scene, number: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Poses of cameras around a scene f64[4, 4] each, from where the pictures show about all objects."""
    middle = scene.poses[:, :3].mean(0)
    far = np.linalg.norm(scene.poses[:, :3] - middle, axis=1)
    reach = float((far + [asset.radius for asset in scene.objects]).max())
    half_field = graspnet.HEIGHT / 2 / graspnet.INTRINSICS[1][1]
    least = max(_NEAREST, reach / half_field)
    places = []
    for _ in range(number):
        tilt = rng.uniform(*_TILTS)
        turn = rng.uniform(0, 2 * np.pi)
        away = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        eye = middle + rng.uniform(*_FARTHER) * least * away
        places.append(Camera.looking(eye, middle).T_world_camera)
    return places
