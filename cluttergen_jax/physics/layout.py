"""What an engine has to know about a compiled model: which geom and which body belong to which object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from cluttergen_jax.physics.doors import DoorLayout


@dataclass(frozen=True, eq=False)
class Layout:
    """A compiled model with K free objects and one fixed support.

    Object k's free joint is the k-th: its qpos is qpos[7 k : 7 k + 7], its tree is k.

    Attributes:
      model: its qpos0 parks every object apart from all others and from the support.
      num_objects: K.
      body_index: i32[K], the model's body of each object.
      geom_object: i32[num geoms], the object that a geom belongs to, K for the support.
      center_of_mass: f64[K, 3], in each object's frame, metres.
      top: height of the support's top, metres.
      compile_walled: compiles the same model with walls of air (`assets.mjcf.add_air_walls`), for piles;
        None where nothing is piled.
      doors: what is closed before the last check; None where nothing is.
    """

    model: mujoco.MjModel
    num_objects: int
    body_index: np.ndarray
    geom_object: np.ndarray
    center_of_mass: np.ndarray
    top: float
    compile_walled: Callable[[], mujoco.MjModel] | None = None
    doors: DoorLayout | None = None

    @staticmethod
    def of(
        model: mujoco.MjModel,
        top: float,
        compile_walled: Callable[[], mujoco.MjModel] | None = None,
    ) -> Layout:
        """Reads the layout of a model whose only joints are the objects' free joints."""
        body_index = np.asarray(model.jnt_bodyid, np.int32)
        object_of_body = np.full(model.nbody, model.njnt, np.int32)
        object_of_body[body_index] = np.arange(model.njnt)
        return Layout(
            model=model,
            num_objects=int(model.njnt),
            body_index=body_index,
            geom_object=object_of_body[model.geom_bodyid],
            center_of_mass=model.body_ipos[body_index].copy(),
            top=top,
            compile_walled=compile_walled,
        )

    @property
    def parked(self) -> np.ndarray:
        """f64[K, 7]: where objects wait that are not placed."""
        return self.model.qpos0.reshape(self.num_objects, 7).copy()
