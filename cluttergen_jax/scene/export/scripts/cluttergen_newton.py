"""Exported scenes in Newton: each is a world of its own, with other objects in each.

    import newton, cluttergen_newton           # Newton 1.8 with newton[sim], trimesh and scipy

    builder = newton.ModelBuilder()
    worlds = cluttergen_newton.add_worlds(builder, [0, 1])       # worlds[0]["mug"]: a body's number
    model = builder.finalize()
    solver = cluttergen_newton.make_solver(model)

newton[sim] 1.8 wants MuJoCo 3.17, not 4. Scenes are added with `collapse_fixed_joints`: a support that is a
body of its own is filtered against the floor, and with such filters Newton takes 256 shapes at most ("The
heterogeneous geom collision graph exceeds the MuJoCo mask compiler's capacity").
"""

# ruff: noqa: E402
from pathlib import Path

from host_checks import check_versions, scene_number

ROOT = Path(__file__).resolve().parent
KNOWN = {"newton": ("1.8.",), "mujoco": ("3.17.",)}
"""How the versions begin that this was run with."""
check_versions(
    KNOWN, "'newton[sim]==1.8.0' trimesh scipy", ("newton", "mujoco", "trimesh", "scipy")
)

import newton

_CONTACTS = 40
_ROWS = 150
"""Room for contacts and rows of constraints, for each object of a world."""


def scene_numbers():
    """The numbers of all scenes in the folder."""
    return sorted(int(path.stem) for path in (ROOT / "scenes").glob("*.xml"))


def add_worlds(builder, numbers=None, robot=None):
    """Adds a world for each scene, all of the same number of objects, whichever these are.

    Args:
      builder: a `newton.ModelBuilder`, on which no custom attributes need be registered.
      numbers: of the scenes, a list; all if not given.
      robot: a builder whose bodies are added to each world, before the scene's.

    Returns:
      For each world, the number of the body of each object, by name.

    Raises:
      ValueError: there is no such scene, no scene is asked for, or their numbers of objects differ.
    """
    known = scene_numbers()
    if numbers is None:
        numbers = known
    elif isinstance(numbers, str) or not hasattr(numbers, "__iter__"):
        raise ValueError(f"numbers = {numbers!r}. Allowed: a list. Try: [{numbers}]")
    numbers = [scene_number(each, known, ROOT) for each in numbers]
    if not numbers:
        raise ValueError("numbers = []. Allowed: one scene or more. Try: leaving it out, for all")
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    worlds = []
    for number in numbers:
        path = ROOT / "scenes" / f"{number:06d}.xml"
        world = newton.ModelBuilder()
        newton.solvers.SolverMuJoCo.register_custom_attributes(world)
        if robot is not None:
            world.add_builder(robot)
        scene = newton.ModelBuilder()
        newton.solvers.SolverMuJoCo.register_custom_attributes(scene)
        scene.add_mjcf(str(path), parse_visuals=False, collapse_fixed_joints=True)
        first = builder.body_count + world.body_count
        names = [label.rsplit("/", 1)[-1] for label in scene.body_label]
        worlds.append({name: first + place for place, name in enumerate(names)})
        if len(worlds[0]) != len(names):
            raise ValueError(
                f"scene {number} has {len(names)} objects and scene {numbers[0]} {len(worlds[0])}: Newton's "
                "worlds have the same number of bodies; add those of one number"
            )
        world.add_builder(scene)
        builder.add_world(world)
    return worlds


def make_solver(model, **options):
    """A `SolverMuJoCo` with room for the contacts of the scenes; options: its own, which go before."""
    num_bodies = model.body_count // max(1, model.world_count)
    room = {"nconmax": _CONTACTS * num_bodies, "njmax": _ROWS * num_bodies}
    return newton.solvers.SolverMuJoCo(model, **{**room, **options})
