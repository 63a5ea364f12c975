"""Contact forces of a scene at rest, and its support graph: who rests on whom."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cluttergen_jax.judging.scene_models import SceneModels, StandingModel, each_scene
from cluttergen_jax.physics.margin import margins_of

BORNE_SHARE = 0.1
_SETTLE_SECONDS = 0.1


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of scenes at rest. N scenes, K objects; index K stands for the support and the floor.

    Attributes:
      force: f64[N, K, K + 1, 3], newtons, world: what j does to i, friction included.
      normal: f64[N, K, K + 1, 3], newtons, the same without friction.
      weight: f64[N, K], newtons; zero where not placed.
      count: i32[N], contact points.
      penetration: f64[N], metres, the deepest overlap of any two bodies as the scene was given.
      margin: f64[N, K], metres, each object's support margin (`physics.margin`); NaN where not placed and
        where nothing carries it.
    """

    force: np.ndarray
    normal: np.ndarray
    weight: np.ndarray
    count: np.ndarray
    penetration: np.ndarray
    margin: np.ndarray

    @property
    def rests_on(self) -> np.ndarray:
        """bool[N, K, K + 1]: j bears at least a tenth of i's weight."""
        borne = self.force[..., 2] >= BORNE_SHARE * self.weight[..., None]
        return borne & (self.weight[..., None] > 0)

    @property
    def carried_by(self) -> np.ndarray:
        """bool[N, K, K + 1]: i rests on j, directly or through others."""
        return closure(self.rests_on)


def closure(rests_on: np.ndarray) -> np.ndarray:
    """bool[N, K, K + 1]: whether a chain of supports leads from i to j."""
    reach = np.array(rests_on, bool)
    for middle in range(reach.shape[1]):
        reach |= reach[:, :, middle, None] & reach[:, middle, None, :]
    return reach


def contacts_of(
    models: SceneModels, poses: np.ndarray, is_placed: np.ndarray, num_threads: int = 0
) -> Contacts:
    """Forces between the bodies of finished scenes.

    Contacts and overlap are those of the poses as given; forces are read after 0.1 s of simulation,
    everything awake, when those of rounding the poses have died away; margins are the larger of both times.

    Args:
      poses: f[N, K, 7], world, metres, wxyz; is_placed: bool[N, K].
    """
    models.check(poses, is_placed)
    is_placed = np.asarray(is_placed, bool)
    num, size = is_placed.shape
    result = Contacts(
        force=np.zeros((num, size, size + 1, 3)),
        normal=np.zeros((num, size, size + 1, 3)),
        weight=np.zeros((num, size)),
        count=np.zeros(num, np.int32),
        penetration=np.zeros(num),
        margin=np.full((num, size), np.nan),
    )

    def run(scene: int) -> None:
        model = models.of(is_placed[scene])
        data = model.start(poses[scene])
        result.count[scene] = data.ncon
        margin = _margins(model, data)
        result.penetration[scene] = max(-data.contact.dist.min(initial=0.0), 0.0)
        mujoco.mj_step(model.model, data, round(_SETTLE_SECONDS / model.model.opt.timestep))
        mujoco.mj_forward(model.model, data)
        mass = model.model.body_mass[model.layout.body_index]
        result.weight[scene, model.objects] = mass * models.contact.gravity
        _add_forces(model, data, result.force[scene], result.normal[scene])
        # Of a face that lies flat the engine names a few points, now these and now those: no margin is found
        # too large, and the larger of two is nearer to the truth.
        margin = np.maximum(margin, _margins(model, data))
        result.margin[scene, model.objects] = np.where(np.isfinite(margin), margin, np.nan)

    each_scene(run, num, num_threads)
    return result


def _margins(scene: StandingModel, data: mujoco.MjData) -> np.ndarray:
    """f64[n]: the support margin of each object of one scene."""
    return margins_of(scene.layout, data, np.arange(len(scene.objects)))


def _add_forces(
    scene: StandingModel, data: mujoco.MjData, force: np.ndarray, normal: np.ndarray
) -> None:
    """Adds the contacts of one scene to f64[K, K + 1, 3]."""
    # The world's index of a model's geom; the last one is the support, and the floor.
    index = np.append(scene.objects, force.shape[0])[scene.layout.geom_object]
    wrench = np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        mujoco.mj_contactForce(scene.model, data, number, wrench)
        # Rows of the frame are its axes, the first one pointing from the first geom to the second.
        frame = contact.frame.reshape(3, 3)
        first, second = index[contact.geom]
        for onto, by, sign in ((second, first, 1.0), (first, second, -1.0)):
            if onto < force.shape[0]:
                force[onto, by] += sign * (wrench[:3] @ frame)
                normal[onto, by] += sign * wrench[0] * frame[0]
