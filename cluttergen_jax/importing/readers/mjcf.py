"""MJCF bodies: compiled by MuJoCo itself, geoms turned into meshes."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from cluttergen_jax.assets.config import MAX_TEXTURE
from cluttergen_jax.assets.mass import MassProperties, combine_masses
from cluttergen_jax.assets.mesh import Mesh
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.mjcf_compile import (
    NO_MASS,
    compile_with_notes,
    parse_mjcf,
)
from cluttergen_jax.importing.readers.mjcf_geoms import (
    geom_mesh,
    geom_piece,
    is_convex,
    picture_notes,
    roles_of,
)
from cluttergen_jax.importing.readers.model import (
    MAX_PARTS,
    Model,
    check_joints,
    frozen_note,
    opened_joint,
    sound_mass,
    unknown_body,
)

_JOINT = mujoco.mjtJoint
_MOVABLE = {_JOINT.mjJNT_HINGE: "hinge", _JOINT.mjJNT_SLIDE: "slide", _JOINT.mjJNT_BALL: "ball"}


def read_mjcf(
    path: Path,
    body: str = "",
    max_side: int = MAX_TEXTURE,
    opened: Mapping[str, float] | None = None,
    bodies: Sequence[str] = (),
) -> Model:
    """One body with all that hangs on it, at the model's reference configuration.

    Pieces are the geoms that are seen, parts those that collide (`mjcf_roles`): MuJoCo takes the convex
    hull of each, so they are convex parts already, but for height fields and SDFs.

    Args:
      path: the MJCF file.
      body: the body's name, or "#N" for the N-th body of the world, or "" for the only one.
      max_side: pixels; larger images are shrunk.
      opened: where hinges and slides are to be instead, degrees or metres, by name; given for furniture,
        which has what lies in the world itself, too.
      bodies: several bodies of the world, named likewise, that are one piece of furniture.

    Returns:
      The model; its parts are None if there are more than 32 or one is not convex, its mass is what MuJoCo
      makes of the file.

    Raises:
      AssetError: MuJoCo cannot compile the file (its own message is kept), or nothing of the body is seen
        or collides.
    """
    model, of_pictures = compile_with_notes(path)
    if model.nflex and not model.ngeom:
        raise AssetError(f"{path} holds soft bodies alone (flex)", "rigid bodies with geoms")
    data = mujoco.MjData(model)
    of_joints = _open_joints(model, data, opened or {}, path)
    mujoco.mj_kinematics(model, data)
    roots = _roots(model, path, body, bodies, opened is not None)
    root = roots[0]
    chosen = [i for i in range(model.nbody) if any(_hangs_on(model, i, k) for k in roots)]
    geoms = [i for i in range(model.ngeom) if model.geom_bodyid[i] in chosen]
    roles = roles_of(model, data, geoms)
    if not roles.surface:
        why = "; ".join(roles.notes) or "it has no geoms"
        raise AssetError(
            f"{path}: nothing of body {model.body(root).name or body!r} can be an object: {why}",
            "geoms in groups 0 to 2 with an alpha above 0, or geoms that collide; planes do not count",
        )
    of_pictures = (*of_pictures, *picture_notes(model, roles.surface))
    colliding = tuple(geom_mesh(model, data, i, 16) for i in roles.colliding)
    notes = (*frozen_note(_frozen_joints(model, data, chosen)), *of_joints, *roles.notes)
    if root and not body and not bodies and (beside := len(_in_world(model))):
        notes += (f"left out, as they lie in the world beside the body: {beside} geoms",)
    if kilograms := _mass_of(path, roles.unseen):
        notes += (f"what is left out weighs {kilograms:.3g} kg: it counts, as in MuJoCo",)
    is_usable = 0 < len(colliding) <= MAX_PARTS and all(
        is_convex(model, i) for i in roles.colliding
    )
    return Model(
        pieces=[geom_piece(model, data, i, max_side) for i in roles.surface],
        parts=tuple(Mesh.points(each.vertices) for each in colliding) if is_usable else None,
        stated=combine_masses(
            [_body_mass(model, data, i) for i in chosen if model.body_mass[i] != NO_MASS]
        ),
        notes=(*notes, *dict.fromkeys(of_pictures)),
        colliding=colliding,
        # One body that was chosen stands still itself.
        joints=_joints(model, data, roles.surface, [i for i in chosen if i != root or not body]),
    )


def _open_joints(
    model: mujoco.MjModel, data: mujoco.MjData, opened: Mapping[str, float], path: Path
) -> list[str]:
    """Puts joints where they are asked for; what is to be said of that."""
    notes: list[str] = []
    movable = {model.joint(index).name: index for index in _hinges_and_slides(model)}
    check_joints(opened, movable, path)
    for name, value in opened.items():
        index = movable[name]
        lower, upper = (
            model.jnt_range[index].tolist() if model.jnt_limited[index] else (-np.inf, np.inf)
        )
        is_turn = bool(model.jnt_type[index] == _JOINT.mjJNT_HINGE)
        place, said = opened_joint(name, value, lower, upper, is_turn)
        data.qpos[model.jnt_qposadr[index]] = place
        notes += said
    return notes


def _frozen_joints(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]
) -> Iterator[tuple[str, str, float, bool]]:
    for joint in range(model.njnt):
        kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind in _MOVABLE and int(model.jnt_bodyid[joint]) in bodies:
            is_ball = kind == _JOINT.mjJNT_BALL
            value = 0.0 if is_ball else float(data.qpos[model.jnt_qposadr[joint]])
            yield (model.joint(joint).name, _MOVABLE[kind], value, kind != _JOINT.mjJNT_SLIDE)


def _hinges_and_slides(model: mujoco.MjModel) -> list[int]:
    """Their numbers. A whole number of NumPy is never found `in` a tuple of MuJoCo's enums."""
    kinds = [int(_JOINT.mjJNT_HINGE), int(_JOINT.mjJNT_SLIDE)]
    return [int(index) for index in np.flatnonzero(np.isin(model.jnt_type, kinds))]


def _joints(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], bodies: Collection[int]
) -> tuple[Joint, ...]:
    """The hinges and slides of some bodies with what each moves, by number of these geoms."""
    own = [index for index in _hinges_and_slides(model) if int(model.jnt_bodyid[index]) in bodies]
    numbers = {index: number for number, index in enumerate(own)}
    last: dict[int, int] = {0: -1}
    parent: dict[int, int] = {}
    for body in range(1, model.nbody):
        last[body] = last[int(model.body_parentid[body])]
        first = int(model.body_jntadr[body])
        for index in range(first, first + int(model.body_jntnum[body])):
            if index in numbers:
                parent[index], last[body] = last[body], numbers[index]
    moved = [last[int(model.geom_bodyid[geom])] for geom in geoms]
    joints = []
    for index, number in numbers.items():
        dof = model.jnt_dofadr[index]
        joint = Joint(
            name=model.joint(index).name or f"joint_{number}",
            kind="slide" if model.jnt_type[index] == _JOINT.mjJNT_SLIDE else "hinge",
            anchor=tuple(data.xanchor[index].tolist()),
            axis=tuple(data.xaxis[index].tolist()),
            value=float(data.qpos[model.jnt_qposadr[index]]),
            range=tuple(model.jnt_range[index].tolist()) if model.jnt_limited[index] else None,
            parent=parent[index],
            pieces=tuple(place for place, by in enumerate(moved) if by == number),
            damping=_above_zero(model.dof_damping[dof]),
            friction=_above_zero(model.dof_frictionloss[dof]),
            armature=_above_zero(model.dof_armature[dof]),
        )
        own_bodies = [body for body in bodies if last[body] == number]
        masses = [_body_mass(model, data, body) for body in own_bodies]
        joints.append(joint.with_mass(sound_mass(masses)))
    return tuple(joints)


def _above_zero(value: float) -> float | None:
    """What MJCF has for what is not stated is zero."""
    return float(value) if value > 0 else None


def _body_mass(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> MassProperties:
    """One body's own mass in the world frame of the reference configuration."""
    axes = data.ximat[body].reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    return MassProperties(float(model.body_mass[body]), data.xipos[body].copy(), inertia)


def _mass_of(path: Path, geoms: Collection[int]) -> float:
    """Kilograms that geoms add to their bodies; 0 where these state their own, or consist of nothing else."""
    if not geoms:
        return 0.0
    try:
        spec = parse_mjcf(path)[0]
        before = spec.compile().body_mass.sum()
        for geom in spec.geoms:
            if geom.id in geoms:
                geom.mass = 0.0
        return float(before - spec.compile().body_mass.sum())
    except ValueError:
        return 0.0


def world_bodies(model: mujoco.MjModel) -> list[int]:
    """The bodies that hang on the world, in the model's order."""
    return [i for i in range(1, model.nbody) if model.body_parentid[i] == 0]


def _roots(
    model: mujoco.MjModel, path: Path, body: str, bodies: Sequence[str], is_furniture: bool
) -> list[int]:
    """The bodies' ids; 0, the world body, where the geoms lie in the world itself."""
    children = world_bodies(model)
    # Of furniture some parts may lie in the world itself; beside what is free there is scenery.
    kinds = model.jnt_type[np.isin(model.jnt_bodyid, children)]
    is_whole = is_furniture and bool(_in_world(model)) and not (kinds == _JOINT.mjJNT_FREE).any()
    if bodies and is_whole and len(bodies) == len(children):
        return [0]
    if body or bodies:
        return [_body_id(model, path, each) for each in bodies or (body,)]
    if len(children) > 1:
        names = ", ".join(model.body(i).name for i in children)
        raise AssetError(f"{path} holds {len(children)} bodies and none was chosen", names)
    return [0 if is_whole or not children else children[0]]


def _body_id(model: mujoco.MjModel, path: Path, body: str) -> int:
    names = [model.body(i).name for i in range(1, model.nbody)]
    if body in names:
        return 1 + names.index(body)
    number = body.removeprefix("#")
    children = world_bodies(model)
    if number != body and number.isdecimal() and int(number) < len(children):
        return children[int(number)]
    raise unknown_body(body, path, names)


def _in_world(model: mujoco.MjModel) -> list[int]:
    """The geoms of the world body, planes aside."""
    is_plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    return [int(i) for i in np.flatnonzero((model.geom_bodyid == 0) & ~is_plane)]


def _hangs_on(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body not in (root, 0):
        body = int(model.body_parentid[body])
    return body == root
