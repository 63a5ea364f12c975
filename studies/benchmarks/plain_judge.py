"""The rule of `cluttergen judge` written a second time: a straight loop, in the MuJoCo of this interpreter.

It imports nothing of cluttergen_jax, so that both can be compared, and scenes be judged in any version from
3.3 on:

    python -m venv other && other/bin/pip install mujoco==3.10.0
    other/bin/python studies/benchmarks/plain_judge.py SCENE.xml ... --hold-joints

Every step is looked at; gaps come from distances between geoms, turns from rotation matrices.
"""

import argparse
import copy
import json
from pathlib import Path

import mujoco
import numpy as np

FREE = mujoco.mjtJoint.mjJNT_FREE
MAX_SHIFT = 0.005
MAX_TURN = np.radians(5.0)
MAX_DEPTH = 0.001
GAP = 0.001
AT_ONCE = 0.05
FALL = 0.05


def starts_of(model, path, most):
    """Names and positions of the starts: rows of an array beside the file, keyframes, or the file's own."""
    beside = path.with_suffix(".npz")
    if beside.is_file():
        rows = np.load(beside, allow_pickle=False)["states"][:most]
        first = rows.shape[1] - model.nq - model.nv if rows.shape[1] > model.nq else 0
        return [(str(i), row[first : first + model.nq], -1) for i, row in enumerate(rows)]
    keys = [(model.key(i).name, model.key_qpos[i], i) for i in range(model.nkey)]
    return keys[:most] or [("", model.qpos0, -1)]


def _pulled(model, actuator):
    """The body at which an actuator pulls; -1 for tendons."""
    kind = int(model.actuator_trntype[actuator])
    target = int(model.actuator_trnid[actuator, 0])
    if kind in (0, 1):
        return int(model.jnt_bodyid[target])
    return int(model.site_bodyid[target]) if kind in (2, 4) else target if kind == 5 else -1


def judged(model):
    """The bodies with a free joint that collide and that nothing drives, and their geoms."""
    found = []
    driven = {_pulled(model, i) for i in range(model.nu)}
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        tree = [b for b in range(model.nbody) if model.body_rootid[b] == body]
        geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] in tree]
        collides = any(model.geom_contype[g] or model.geom_conaffinity[g] for g in geoms)
        if model.jnt_type[joint] == FREE and collides and not driven & set(tree):
            found.append((body, geoms))
    return found


def shapes(model):
    """The geoms that can collide with anything: overlaps count between any two of them."""
    return {g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]}


def depths(model, data, bodies):
    """How deep each body is in anything else: by distances, whatever contacts the file leaves out."""
    solid = shapes(model)
    found = {}
    for body, geoms in bodies:
        own = solid & set(geoms)
        pairs = [(a, b) for a in own for b in solid - set(geoms) if is_near(model, data, a, b)]
        gaps = [mujoco.mj_geomDistance(model, data, a, b, GAP, np.zeros(6)) for a, b in pairs]
        found[body] = max(0.0, -min(gaps, default=0.0))
    return found


def collide(model, a, b):
    """Whether two geoms may touch, and are near enough to be asked how far apart they are."""
    kinds = (
        model.geom_contype[a] & model.geom_conaffinity[b],
        model.geom_contype[b] & model.geom_conaffinity[a],
    )
    return any(kinds)


def is_near(model, data, a, b):
    """Whether the spheres around two geoms come within the gap; planes have none."""
    reach = model.geom_rbound[a] + model.geom_rbound[b] + GAP
    is_endless = 0 in (model.geom_rbound[a], model.geom_rbound[b])
    return is_endless or np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b]) <= reach


def lifted(model, data, bodies):
    """Which bodies something at most a gap away presses upwards: collided with wider margins."""
    wide = copy.copy(model)
    wide.geom_margin[:] = np.maximum(model.geom_margin, GAP)
    other = mujoco.MjData(wide)
    other.qpos[:] = data.qpos
    mujoco.mj_forward(wide, other)
    below = set()
    for contact in other.contact:
        first, second = (
            int(model.body_rootid[model.geom_bodyid[g]]) for g in (contact.geom1, contact.geom2)
        )
        if (
            contact.dist <= GAP
            and first != second
            and abs(contact.frame[2]) >= np.sin(np.radians(10))
        ):
            below.add(second if contact.frame[2] > 0 else first)
    return np.array([body in below for body, _ in bodies], bool)


def carried(model, data, bodies):
    """Which bodies a chain of small gaps joins to anything that is not judged."""
    own = {g for _, geoms in bodies for g in geoms}
    groups = [*(geoms for _, geoms in bodies), [g for g in range(model.ngeom) if g not in own]]
    touch = np.eye(len(groups), dtype=bool)
    for i in range(len(groups)):
        for j in range(i):
            touch[i, j] = touch[j, i] = any(
                mujoco.mj_geomDistance(model, data, a, b, 2 * GAP, np.zeros(6)) <= GAP
                for a in groups[i]
                for b in groups[j]
                if collide(model, a, b) and is_near(model, data, a, b)
            )
    return np.linalg.matrix_power(touch.astype(int), len(groups))[:-1, -1] > 0


def places_of(data, index, links):
    """Where the bodies are, by their centre of mass as one, and the links by their own."""
    return np.concatenate([data.subtree_com[index], data.xipos[[b for b, _ in links]]])


def judge(path, detector="native", seconds=(1.0, 10.0), hold_joints=False, most=50):
    """What each body of each start does: a list of records of plain values."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.enableflags &= ~int(getattr(mujoco.mjtEnableBit, "mjENBL_SLEEP", 0))
    model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_AUTORESET", 0))
    flag = int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    model.opt.disableflags = (model.opt.disableflags & ~flag) | (
        flag if detector == "libccd" else 0
    )
    bodies = judged(model)
    records = []
    index = [body for body, _ in bodies]
    # Links with joints of their own, and the place of the body that they hang on.
    links = [b for b in range(1, model.nbody) if b not in index and model.body_jntnum[b]]
    links = [(b, index.index(model.body_rootid[b])) for b in links if model.body_rootid[b] in index]
    parts = [*index, *(b for b, _ in links)]
    owner = [*range(len(index)), *(p for _, p in links)]
    held = [j for j in range(model.njnt) if hold_joints and model.jnt_type[j] != FREE]
    places = [int(model.jnt_qposadr[j]) for j in held], [int(model.jnt_dofadr[j]) for j in held]
    for name, qpos, key in starts_of(model, Path(path), most):
        data = mujoco.MjData(model)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(model, data, key)
        data.qpos[:] = qpos
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        depth = depths(model, data, bodies)
        is_carried = carried(model, data, bodies)
        is_lifted = lifted(model, data, bodies)
        start = places_of(data, index, links)
        turned = data.xmat[parts].reshape(-1, 3, 3).copy()
        held_at = data.qpos[places[0]].copy()
        far = np.zeros(len(index))
        most_turned = np.zeros(len(index))
        still = []
        sunk = np.zeros(len(index))
        for step in range(1, round(seconds[-1] / model.opt.timestep) + 1):
            mujoco.mj_step(model, data)
            if held:
                data.qpos[places[0]] = held_at
                data.qvel[places[1]] = 0
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            moved = places_of(data, index, links) - start
            trace = np.einsum("bij,bij->b", data.xmat[parts].reshape(-1, 3, 3), turned)
            np.maximum.at(far, owner, np.nan_to_num(np.linalg.norm(moved, axis=1), nan=np.inf))
            turn = np.arccos(np.clip((trace - 1) / 2, -1, 1))
            np.maximum.at(most_turned, owner, np.nan_to_num(turn, nan=np.inf))
            if step == round(AT_ONCE / model.opt.timestep):
                sunk = -moved[:, 2]
            if step in [round(s / model.opt.timestep) for s in seconds]:
                still.append((far <= MAX_SHIFT) & (most_turned <= MAX_TURN))
        for place, body in enumerate(index):
            records.append(
                {
                    "start": name,
                    "body": model.body(body).name or f"body-{body}",
                    **{f"is_still_{s:g}s": bool(flags[place]) for s, flags in zip(seconds, still)},  # noqa: B905
                    "is_deep": bool(depth[body] > MAX_DEPTH),
                    "floats": bool(
                        not is_carried[place] or (sunk[place] > GAP and not is_lifted[place])
                    ),
                    "falls": bool(-moved[place, 2] > FALL),
                }
            )
    return records


def main():
    """Prints a line for each file."""
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=as_written)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--detector", choices=("native", "libccd"), default="native")
    parser.add_argument("--seconds", nargs="+", type=float, default=(1.0, 10.0))
    parser.add_argument("--hold-joints", action="store_true")
    parser.add_argument("--starts", type=int, default=50)
    given = parser.parse_args()
    for file in given.files:
        found = judge(file, given.detector, given.seconds, given.hold_joints, given.starts)
        flags = {
            name: [each[name] for each in found]
            for name in found[0]
            if name not in ("start", "body")
        }
        shares = {name: round(float(np.mean(values)), 3) for name, values in flags.items()}
        print(
            json.dumps(
                {"file": str(file), "mujoco": mujoco.__version__, "bodies": len(found), **shares}
            )
        )


if __name__ == "__main__":
    main()
