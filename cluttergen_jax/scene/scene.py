"""A finished scene: which objects stand where on which support, and how it came about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.cameras import Camera

if TYPE_CHECKING:
    import mujoco

    from cluttergen_jax.scene.spec import Attachment

_UNIT = 1e-3


@dataclass(frozen=True)
class Origin:
    """How a scene came about; empty or None where nobody knows.

    Attributes:
      bank: the name of the bank's folder.
      index: the scene's number in it.
      pool, method, checkpoint, seed: what it was made of and how.
      verdict: the last word on it, in the words of `types.Verdict`.
      is_success: every slot is filled and the finished scene stands.
      drift: metres that its objects moved at most in the last check.
      versions: of the programs that made it, by name.
    """

    bank: str = ""
    index: int = 0
    pool: str = ""
    method: str = ""
    checkpoint: str | None = None
    seed: int | None = None
    verdict: str = ""
    is_success: bool | None = None
    drift: float | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects on a support.

    Attributes:
      names: N unique names, in the order of placement.
      objects: their assets; the same one may stand there more than once.
      poses: f64[N, 7], T_world_object, metres, wxyz.
      support: what carries them.
      stability: the time step with which the scene was checked, among others.
      contact: friction, softness and solver.
      origin: how it came about.
      cameras: around the support; see `scene.cameras.scene_cameras`.

    Raises:
      ConfigError: the numbers of names, objects and poses differ, a name comes twice, or a pose is none.
    """

    names: tuple[str, ...]
    objects: tuple[ObjectAsset, ...]
    poses: np.ndarray
    support: SupportAsset
    stability: StabilityConfig = field(default_factory=StabilityConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    origin: Origin = field(default_factory=Origin)
    cameras: tuple[Camera, ...] = ()

    def __post_init__(self) -> None:
        poses = np.array(self.poses, np.float64)
        if not len(self.names) == len(set(self.names)) == len(self.objects) or poses.shape != (
            len(self.names),
            7,
        ):
            raise ConfigError(
                f"a scene of {len(self.names)} names, {len(self.objects)} objects and poses {poses.shape}",
                "as many unique names as objects, and a pose f[7] for each",
            )
        length = np.linalg.norm(poses[:, 3:], axis=1)
        if not (np.isfinite(poses).all() and (np.abs(length - 1) < _UNIT).all()):
            raise ConfigError(
                "a scene with a pose that is not finite or whose quaternion is not of unit length"
            )
        poses[:, 3:] /= length[:, None]
        object.__setattr__(self, "poses", poses)

    @property
    def assets(self) -> dict[str, ObjectAsset]:
        """Each asset of the scene once, by its own name."""
        return {asset.name: asset for asset in self.objects}

    def to_mjspec(self, prefix: str = "") -> mujoco.MjSpec:
        """The scene as a specification of its own: see `scene.spec.to_mjspec`."""
        from cluttergen_jax.scene.spec import to_mjspec

        return to_mjspec(self, prefix)

    def attach_to(
        self,
        spec: mujoco.MjSpec,
        prefix: str = "clutter/",
        *,
        position: Sequence[float] = (0.0, 0.0, 0.0),
        quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
        support: bool = True,
    ) -> Attachment:
        """Puts the scene into somebody's own model: see `scene.spec.attach_to`."""
        from cluttergen_jax.scene.spec import attach_to

        return attach_to(spec, self, prefix, position=position, quaternion=quaternion, support=support)
