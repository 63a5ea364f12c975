"""Many scenes as one compiled model: every object that any of them needs, and a state for each scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import support_hash
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.world import unique_names
from cluttergen_jax.scene.scene import Scene

_Asset = TypeVar("_Asset", ObjectAsset, SupportAsset)


@dataclass(frozen=True, eq=False)
class SceneModel:
    """One compiled model with every object that any of some scenes needs.

    Attributes:
      model: its only joints are the K free joints, in the order of `names`.
      names: K unique names, which bodies and joints bear.
      objects: the K assets.
      first: i32[A], by asset, the first of its objects; the others follow it.
    """

    model: mujoco.MjModel
    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    first: np.ndarray

    def object_index(self, asset_index: np.ndarray) -> np.ndarray:
        """i32[S, N]: the objects of scenes of these assets, i32[S, N]; -1 is padding in both."""
        return np.where(asset_index < 0, -1, self.first[asset_index] + rank_of(asset_index)).astype(
            np.int32
        )

    def qpos(
        self, object_index: np.ndarray, poses: np.ndarray, dtype: type = np.float64
    ) -> np.ndarray:
        """[S, 7 K]: the configuration of scenes: their objects at `poses` [S, N, 7], the others waiting."""
        qpos = np.tile(self.model.qpos0.reshape(1, -1, 7).astype(dtype), (len(object_index), 1, 1))
        scene, slot = np.nonzero(object_index >= 0)
        qpos[scene, object_index[scene, slot]] = poses[scene, slot]
        return qpos.reshape(len(object_index), -1)

    @property
    def lift(self) -> np.ndarray:
        """f64[K, 3], newtons: the force that holds each object in the air."""
        model = self.model
        return -model.opt.gravity * model.body_mass[model.jnt_bodyid, None]

    def is_present(self, object_index: np.ndarray) -> np.ndarray:
        """bool[S, K]: the objects that belong to each scene."""
        is_present = np.zeros((len(object_index), len(self.names)), bool)
        scene, slot = np.nonzero(object_index >= 0)
        is_present[scene, object_index[scene, slot]] = True
        return is_present


def rank_of(asset_index: np.ndarray) -> np.ndarray:
    """i32[S, N]: how many slots before each hold the same asset."""
    rank = np.zeros(asset_index.shape, np.int32)
    for slot in range(1, asset_index.shape[1]):
        rank[:, slot] = (asset_index[:, :slot] == asset_index[:, slot : slot + 1]).sum(1)
    return rank


def compile_scenes(
    assets: Sequence[ObjectAsset],
    most: np.ndarray,
    support: SupportAsset,
    timestep: float,
    contact: ContactConfig,
    *,
    visual: bool = False,
) -> SceneModel:
    """Compiles one model of each asset as often as it is needed at most.

    Args:
      assets, most: each once, and i64[A], how often the scene that has most of it has it.
      visual: whether coloured surfaces come along.
    """
    objects = [asset for asset, number in zip(assets, most, strict=True) for _ in range(number)]
    names = unique_names([asset.name for asset in objects])
    spec = populated_spec(names, objects, support, timestep, contact, visual=visual)
    spec.modelname = "cluttergen scenes"
    first = np.cumsum([0, *most])[:-1].astype(np.int32)
    return SceneModel(spec.compile(), names, tuple(objects), first)


@dataclass(frozen=True, eq=False)
class SceneCollection:
    """S scenes in one model of K objects.

    To begin scene i: set `data.qpos` to qpos[i] and `data.xfrc_applied` to xfrc_applied[i], everything else
    as `mj_resetData` leaves it. Objects that scene i lacks wait in the air, far from everything and from each
    other: they touch nothing, and an applied force as large as their weight keeps them there.

    Attributes:
      compiled: the model.
      object_index: i32[S, N], which object of the model is each scene's n-th; -1 is padding.
      poses: [S, N, 7], where it is, world frame, metres, wxyz.
    """

    compiled: SceneModel
    object_index: np.ndarray
    poses: np.ndarray

    def __repr__(self) -> str:
        return f"SceneCollection({len(self.object_index)} scenes in one model of {len(self.names)} objects)"

    @property
    def model(self) -> mujoco.MjModel:
        """Its only joints are the K free joints, in the order of `names`."""
        return self.compiled.model

    @property
    def names(self) -> tuple[str, ...]:
        """K unique names, which bodies and joints bear."""
        return self.compiled.names

    @property
    def objects(self) -> tuple[ObjectAsset, ...]:
        """The K assets."""
        return self.compiled.objects

    @cached_property
    def qpos(self) -> np.ndarray:
        """f64[S, 7 K]."""
        return self.compiled.qpos(self.object_index, self.poses)

    @cached_property
    def is_present(self) -> np.ndarray:
        """bool[S, K]."""
        return self.compiled.is_present(self.object_index)

    @cached_property
    def xfrc_applied(self) -> np.ndarray:
        """f64[S, nbody, 6]."""
        model = self.model
        force = np.zeros((len(self.object_index), model.nbody, 6))
        force[:, model.jnt_bodyid, :3] = np.where(
            self.is_present[..., None], 0.0, self.compiled.lift
        )
        return force

    def reset(self, data: mujoco.MjData, scene: int) -> None:
        """Puts `data` at rest at the beginning of scene number `scene`."""
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self.qpos[scene]
        data.xfrc_applied[:] = self.xfrc_applied[scene]
        mujoco.mj_forward(self.model, data)


def collect(scenes: Sequence[Scene], *, visual: bool = False) -> SceneCollection:
    """Compiles one model for all scenes: each asset as often as the scene that has most of it.

    Args:
      scenes: at least one, all on one support, with the same contact parameters and time step.
      visual: whether coloured surfaces come along.

    Raises:
      ConfigError: there are no scenes, or they differ in support, contact or time step, or in the content of
        assets of one name.
    """
    if not scenes:
        raise ConfigError("a model of no scenes", "one scene or more")
    scenes = list(check_alike(scenes))
    assets = {asset.name: asset for scene in scenes for asset in scene.objects}
    number = {name: place for place, name in enumerate(assets)}
    shape = (len(scenes), max(len(scene.names) for scene in scenes))
    asset_index = np.full(shape, -1, np.int32)
    poses = np.zeros((*shape, 7), np.float64)
    for row, scene in enumerate(scenes):
        asset_index[row, : len(scene.objects)] = [number[asset.name] for asset in scene.objects]
        poses[row, : len(scene.objects)] = scene.poses
    first = scenes[0]
    compiled = compile_scenes(
        list(assets.values()),
        most_of(asset_index, len(assets)),
        first.support,
        first.stability.timestep,
        first.contact,
        visual=visual,
    )
    return SceneCollection(compiled, compiled.object_index(asset_index), poses)


def most_of(asset_index: np.ndarray, num_assets: int) -> np.ndarray:
    """i64[A]: how often the scene that has most of it has each asset."""
    most = np.zeros(num_assets, int)
    is_there = asset_index >= 0
    np.maximum.at(most, asset_index[is_there], rank_of(asset_index)[is_there] + 1)
    return most


def check_alike(scenes: Iterable[Scene]) -> Iterator[Scene]:
    """The scenes, one by one, as long as one model or one folder can hold them all.

    Raises:
      ConfigError: they differ in support, contact or time step, or in the content of assets of one name.
    """
    first: Scene | None = None
    known: dict[str, ObjectAsset] = {}
    for scene in scenes:
        first = first or scene
        same = (
            first.contact == scene.contact and first.stability.timestep == scene.stability.timestep
        )
        if not (same and _is_same(first.support, scene.support, support_hash)):
            raise ConfigError(
                "scenes of different supports, contacts or time steps",
                "scenes of one bank",
                "those of each bank by themselves",
            )
        for asset in scene.objects:
            if not _is_same(known.setdefault(asset.name, asset), asset, object_hash):
                raise ConfigError(
                    f"two different objects called {asset.name!r}", "scenes of one bank"
                )
        yield scene


def _is_same(one: _Asset, other: _Asset, digest: Callable[[_Asset], str]) -> bool:
    return one is other or digest(one) == digest(other)
