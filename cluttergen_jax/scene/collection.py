"""Many scenes as one compiled model: every object that any of them needs, and a state for each scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import mujoco
import numpy as np

from cluttergen_jax.assets.mjcf import populated_spec
from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import support_hash
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.world import unique_names
from cluttergen_jax.scene.scene import Scene

_Asset = TypeVar("_Asset", ObjectAsset, SupportAsset)


@dataclass(frozen=True, eq=False)
class SceneCollection:
    """S scenes in one model of K objects.

    To begin scene i: set `data.qpos` to qpos[i] and `data.xfrc_applied` to xfrc_applied[i], everything else
    as `mj_resetData` leaves it. Objects that scene i lacks wait in the air, far from everything and from each
    other: they touch nothing, and an applied force as large as their weight keeps them there.

    Attributes:
      model: its only joints are the K free joints, in the order of `names`.
      names: K unique names, which bodies and joints bear.
      objects: the K assets.
      qpos: f64[S, 7 K].
      xfrc_applied: f64[S, nbody, 6].
      is_present: bool[S, K].
      object_index: i32[S, N], which object of the model is each scene's n-th; -1 is padding.
    """

    model: mujoco.MjModel
    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    qpos: np.ndarray
    xfrc_applied: np.ndarray
    is_present: np.ndarray
    object_index: np.ndarray

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
    most: Counter[str] = Counter()
    for scene in scenes:
        most |= Counter(asset.name for asset in scene.objects)
    objects = [assets[name] for name in assets for _ in range(most[name])]
    names = unique_names([asset.name for asset in objects])
    first = scenes[0]
    spec = populated_spec(
        names, objects, first.support, first.stability.timestep, first.contact, visual=visual
    )
    spec.modelname = "cluttergen scenes"
    model = spec.compile()
    return SceneCollection(model, names, tuple(objects), *_states(scenes, model, names))


def check_alike(scenes: Iterable[Scene]) -> Iterator[Scene]:
    """The scenes, one by one, as long as one model or one folder can hold them all.

    Raises:
      ConfigError: they differ in support, contact or time step, or in the content of assets of one name.
    """
    first: Scene | None = None
    known: dict[str, ObjectAsset] = {}
    for scene in scenes:
        first = first or scene
        same = first.contact == scene.contact and first.stability.timestep == scene.stability.timestep
        if not (same and _is_same(first.support, scene.support, support_hash)):
            raise ConfigError(
                "scenes of different supports, contacts or time steps",
                "scenes of one bank",
                "those of each bank by themselves",
            )
        for asset in scene.objects:
            if not _is_same(known.setdefault(asset.name, asset), asset, object_hash):
                raise ConfigError(f"two different objects called {asset.name!r}", "scenes of one bank")
        yield scene


def _is_same(one: _Asset, other: _Asset, digest: Callable[[_Asset], str]) -> bool:
    return one is other or digest(one) == digest(other)


def _states(
    scenes: Sequence[Scene], model: mujoco.MjModel, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """qpos, xfrc_applied, is_present and object_index of every scene."""
    place = {name: index for index, name in enumerate(names)}
    qpos = np.tile(model.qpos0.reshape(1, -1, 7), (len(scenes), 1, 1))
    is_present = np.zeros((len(scenes), len(names)), bool)
    object_index = np.full((len(scenes), max(len(scene.names) for scene in scenes)), -1, np.int32)
    for row, scene in enumerate(scenes):
        own = unique_names([asset.name for asset in scene.objects])
        index = [place[name] for name in own]
        qpos[row, index] = scene.poses
        is_present[row, index] = True
        object_index[row, : len(index)] = index
    force = np.zeros((len(scenes), model.nbody, 6))
    weight = -model.opt.gravity * model.body_mass[model.jnt_bodyid, None]
    force[:, model.jnt_bodyid, :3] = np.where(is_present[..., None], 0.0, weight)
    return qpos.reshape(len(scenes), -1), force, is_present, object_index
