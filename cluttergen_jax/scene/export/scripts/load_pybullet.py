"""Loads an exported scene into PyBullet. It needs pybullet and nothing else.

python load_pybullet.py scenes/000000.json          looks at it (--direct: simulates without a window)

In your own program: `bodies = load_scene("scenes/000000.json", client)`; a pose is a position in metres and a
quaternion xyzw, as everywhere in PyBullet. `object_pose` tells an object's own frame: PyBullet itself reports
the frame of the centre of mass.
"""

import argparse
import json
import time
from pathlib import Path

import pybullet


def find_scene(path):
    """The whole path of a scene's file; one that is not there is looked for beside this script."""
    beside = Path(__file__).resolve().parent
    for found in (Path(path), beside / path):
        if found.is_file():
            return found.resolve()
    scenes = sorted(each.name for each in (beside / "scenes").glob("*.json"))
    known = f"{scenes[0]} to {scenes[-1]}, {len(scenes)} scenes" if scenes else "none"
    raise FileNotFoundError(f"no scene {path}; there are in {beside / 'scenes'}: {known}")


def load_scene(path, client=0):
    """Loads support and objects; sets gravity and time step.

    Args:
      path: a file in the folder `scenes` of the export, seen from where you are or from this file.
      client: a PyBullet client.

    Returns:
      Body numbers by name, "support" among them.

    Raises:
      FileNotFoundError: there is no such scene.
    """
    path = find_scene(path)
    root = path.parent.parent
    scene = json.loads(path.read_text(encoding="utf-8"))
    pybullet.setGravity(*scene["gravity"], physicsClientId=client)
    pybullet.setTimeStep(scene["timestep"], physicsClientId=client)
    support = str(root / scene["support"]["file"])
    bodies = {"support": pybullet.loadURDF(support, useFixedBase=True, physicsClientId=client)}
    for entry in scene["objects"]:
        w, x, y, z = entry["quaternion_wxyz"]
        bodies[entry["name"]] = pybullet.loadURDF(
            str(root / scene["assets"][entry["asset"]]["file"]),
            entry["position"],
            [x, y, z, w],
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
    for body in bodies.values():
        # Bullet's damping is not physics that the scene was checked with.
        pybullet.changeDynamics(body, -1, linearDamping=0, angularDamping=0, physicsClientId=client)
    return bodies


def object_pose(body, client=0):
    """Position and quaternion xyzw of the object frame of a body, world frame."""
    position, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    info = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)
    inverse = pybullet.invertTransform(info[3], info[4])
    return pybullet.multiplyTransforms(position, turn, *inverse)


def main():
    """Shows a scene, or simulates it without a window and tells how far objects moved."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("scene", help="scenes/NUMBER.json")
    parser.add_argument("--direct", action="store_true", help="no window")
    parser.add_argument("--seconds", type=float, default=10.0)
    args = parser.parse_args()
    try:
        find_scene(args.scene)
    except FileNotFoundError as error:
        parser.error(str(error))
    client = pybullet.connect(pybullet.DIRECT if args.direct else pybullet.GUI)
    bodies = load_scene(args.scene, client)
    timestep = pybullet.getPhysicsEngineParameters(physicsClientId=client)["fixedTimeStep"]
    start = {
        name: object_pose(body, client)[0] for name, body in bodies.items() if name != "support"
    }
    for _ in range(round(args.seconds / timestep)):
        pybullet.stepSimulation(physicsClientId=client)
        if not args.direct:
            time.sleep(timestep)
    for name, before in start.items():
        after = object_pose(bodies[name], client)[0]
        moved = sum((a - b) ** 2 for a, b in zip(after, before, strict=True)) ** 0.5
        print(f"{name}: moved {'< 0.001' if moved < 1e-6 else f'{1000 * moved:.3f}'} mm")
    pybullet.disconnect(client)


if __name__ == "__main__":
    main()
