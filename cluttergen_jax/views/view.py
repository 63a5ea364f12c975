"""A scene as cameras see it, and one view of it, whoever makes it and whatever becomes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.sensing import FIRST_OBJECT, Camera, Instance


@dataclass(frozen=True, eq=False)
class SeenScene:
    """A scene before cameras, of N objects.

    Attributes:
      number: in its bank. names: unique ones, of the objects.
      objects: the same asset may come several times. poses: f64[N, 7], T_world_object, metres, wxyz.
      support: what carries them. region: that the scene was made in, about which cameras stand.
    """

    number: int
    names: Sequence[str]
    objects: Sequence[ObjectAsset]
    poses: np.ndarray
    support: SupportAsset
    region: Rectangle

    @property
    def camera_support(self) -> SupportAsset:
        """The support as cameras are placed by it."""
        return replace(self.support, region=self.region)


@dataclass(frozen=True, eq=False)
class View:
    """What one camera sees of a scene. H rows, W columns, N objects.

    Attributes:
      depth: f32[H, W], metres along the optical axis, not along the ray; inf where nothing is, nan where a
        noisy camera measured nothing. Files encode it in their own ways, and are read back as this.
      label: i[H, W], 0 floor or nothing, 1 support, 2 + k object k; perception has 0 for the support, too,
        1 for the robot's arm, and numbers objects as its pool does.
      camera: of this size, where the view was seen from, or is believed to have been.
      rgb: u8[H, W, 3]; None where no colours were drawn.
      instances: of each object, masks and boxes; () where they were not asked for.
    """

    depth: np.ndarray
    label: np.ndarray
    camera: Camera
    rgb: np.ndarray | None = None
    instances: tuple[Instance, ...] = ()

    @property
    def colours(self) -> np.ndarray:
        """u8[H, W, 3], of a view that was drawn."""
        assert self.rgb is not None, "no colours were drawn"
        return self.rgb

    def mask(self, index: int) -> np.ndarray:
        """bool[H, W]: the pixels of one object."""
        return self.label == FIRST_OBJECT + index
