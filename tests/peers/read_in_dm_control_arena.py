"""Steps exported scenes as arenas of dm_control's composer; needs dm_control. Prints JSON.

python read_in_dm_control_arena.py EXPORT SECONDS; see test_export_dm_control.
"""

import json
import sys
from pathlib import Path

# ruff: noqa: E402
folder = sys.argv[1]
seconds = float(sys.argv[2])
sys.path.insert(0, folder)

import numpy as np
from cluttergen_dm_control import ClutterArena, add_scene, scene_numbers
from dm_control import composer, mjcf
from dm_control.composer.arena import Arena
from dm_control.entities.props.primitive import Primitive


class Task(composer.Task):
    """Nothing to do, beside a prop of dm_control's own that an arena gives a free joint."""

    def __init__(self, arena):
        self._arena = arena
        self.prop = Primitive(geom_type="box", size=(0.02, 0.02, 0.02), mass=0.1)
        frame = arena.add_free_entity(self.prop)
        frame.pos = (1.5, 1.5, 0.02)
        step = arena.mjcf_model.option.timestep
        self.set_timesteps(control_timestep=24 * step, physics_timestep=step)

    @property
    def root_entity(self):
        """The arena."""
        return self._arena

    def get_reward(self, physics):
        """None."""
        return 0.0


def poses(arena, physics):
    """Positions and quaternions wxyz by name."""
    return {
        name: np.concatenate(each.get_pose(physics)).tolist()
        for name, each in arena.objects.items()
        if name != "support"
    }


def masses(arena, physics):
    """Kilograms by name."""
    found = {
        name: each.mjcf_model.find("body", "object")
        for name, each in arena.objects.items()
        if name != "support"
    }
    return {name: float(physics.bind(body).mass) for name, body in found.items()}


def episode(env, arena):
    """A reset, and what moves in so many seconds."""
    env.reset()
    before = poses(arena, env.physics)
    while env.physics.time() < seconds:
        env.step(np.zeros(env.action_spec().shape))
    return {
        "scene": arena.scene,
        "before": before,
        "after": poses(arena, env.physics),
        "mass": masses(arena, env.physics),
        "finite": bool(np.isfinite(env.physics.data.qpos).all()),
    }


report = {"fixed": [], "drawn": []}
for kind, scene in (("fixed", scene_numbers()[-1]), ("drawn", None)):
    arena = ClutterArena(scene=scene)
    env = composer.Environment(Task(arena), random_state=0)
    report[kind] = [episode(env, arena) for _ in range(2)]
own = Arena()
add_scene(own, scene_numbers()[0])
file = Path(folder) / "scenes" / f"{scene_numbers()[0]:06d}.xml"
alone = mjcf.Physics.from_xml_path(str(file)).model.opt
given = mjcf.Physics.from_mjcf_model(own.mjcf_model).model.opt
fields = ("timestep", "cone", "impratio", "iterations", "disableflags", "enableflags")
report["options"] = [[float(getattr(each, field)) for field in fields] for each in (alone, given)]
print(json.dumps(report))
