"""A bank of scenes in mjlab: other objects in each world, and a reset that puts them as in a scene.

    from cluttergen_mjlab import Clutter       # beside bank_reader.py; needs mjlab 1.6 and pyarrow

    clutter = Clutter("bank")
    cfg.scene.entities |= clutter.entities()   # "support", "clutter_0", "clutter_1", ...
    cfg.events |= clutter.events()             # "clutter_friction", "reset_clutter"
    cfg.sim = clutter.simulation()             # the contacts that the scenes were checked with

`python cluttergen_mjlab.py train Cluttergen-Lift-Yam` is mjlab's own program with a task for each of its arms
(`register`): one object of each scene is lifted, the slimmest; `play` shows what was learnt.

A world keeps its objects: those of scene (its number modulo the number of scenes). A reset draws among all
scenes of the same objects: banks of `cluttergen generate --sets K` have many of each, others mostly one.
"""

# ruff: noqa: E402
import math
import re
import sys
import warnings
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path

_HOST = (1, 6)
"""The version of mjlab whose merging of variants this was written for and tested with."""
_FAULTS = {
    "mujoco-warp": (
        (3, 16),
        "with the elliptic cone things at rest turn into NaN (mujoco_warp#1657); simulation() takes another",
    )
}
"""Of packages that mjlab brings: the first version without a fault, and what it is."""


def _version(package):
    return tuple(map(int, re.findall(r"\d+", metadata.version(package))[:2]))


def _is_installed(package):
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True


def _has_fault(package):
    return _version(package) < _FAULTS[package][0]


def _check_host():
    """Refuses no or another mjlab before anything of it is used; tells of faults of what it brings."""
    missing = [name for name in ("mjlab", *_FAULTS, "pyarrow") if not _is_installed(name)]
    if missing:
        raise ImportError(
            f"{', '.join(missing)} not installed. Try: pip install mjlab==1.6.0 pyarrow"
        )
    if _version("mjlab") != _HOST:
        raise ImportError(
            f"mjlab {metadata.version('mjlab')}. Allowed: {_HOST[0]}.{_HOST[1]}. "
            "Try: pip install mjlab==1.6.0, or an export by a newer cluttergen_jax."
        )
    for package, (_, fault) in _FAULTS.items():
        if _has_fault(package):
            warnings.warn(f"{package} {metadata.version(package)}: {fault}", stacklevel=3)


_check_host()

import mujoco
import numpy as np
import torch
from bank_reader import Bank, BankError
from mjlab.entity import EntityCfg
from mjlab.entity.variants import VariantEntityCfg
from mjlab.managers.event_manager import EventTermCfg, requires_model_fields
from mjlab.managers.observation_manager import ObservationTermCfg
from mjlab.sim.sim import MujocoCfg, SimulationCfg
from mjlab.tasks.registry import list_tasks, load_rl_cfg, load_runner_cls, register_mjlab_task
from mjlab.utils.lab_api.math import quat_apply_inverse

_BODY = "object"
# Metres: where objects are before the first reset, and between two.
_ABOVE = 3.0
_AWAY = 1.0
_GAP = 0.1
"""Metres from the region's side to a robot's base."""
_SPECK = 1e-4
"""Metres: of the mesh that fills a slot for which an object has no part, deep within its first part."""
_GREY = (0.5, 0.5, 0.5, 1.0)
"""A geom's own colour that lets its material's be seen."""
_CONTROL = 0.02
"""Seconds between two actions of the tasks."""
_CONTACTS = 48
_ROWS = 288
"""Of contacts and of their constraints that are kept for each object of a world."""


class Clutter:
    """The scenes of a bank that succeeded, all of N objects.

    Args:
      bank: its folder; this file's own, or its `bank`, if not given.

    Attributes:
      names: for each slot, the objects that occur in it.
      sets: i64[C, N], the sets of objects that scenes have, numbers in `bank.names`; the slimmest first, but
        where objects have a friction of their own the most slippery first.
      poses: f32[S, N, 7], of scenes sorted by set, world frame of a scene, metres, wxyz.
      scenes_of_set: i64[C], how many scenes each set has.
      target: the slot whose objects are slim in all sets; the tasks lift it.
    """

    def __init__(self, bank=None):
        folder = Path(__file__).resolve().parent
        self.bank = Bank(bank or (folder / "bank" if (folder / "bank").is_dir() else folder))
        arrays = self.bank.arrays
        if not arrays.is_placed.all():
            raise BankError("scenes of different numbers of objects", "the same number in each")
        self._parts = {}
        used = np.unique(arrays.object_index)
        names = {number: self.bank.names[number].partition("#")[0] for number in used}
        width = {number: self._width(name) for number, name in names.items()}
        own = {number: self._own_friction(name) for number, name in names.items()}
        # Of two objects with a friction of their own the more slippery decides: it has the earlier slot.
        rank = sorted(names, key=lambda number: (own[number] or math.inf, width[number], number))
        place = np.zeros(max(names) + 1, np.int64)
        place[rank] = np.arange(len(rank))
        order = np.argsort(place[arrays.object_index], axis=1, kind="stable")
        objects = np.take_along_axis(arrays.object_index, order, axis=1)
        self.sets, set_of_scene = np.unique(objects, axis=0, return_inverse=True)
        set_of_scene = set_of_scene.ravel()
        by_set = np.argsort(set_of_scene, kind="stable")
        self.poses = np.take_along_axis(arrays.poses, order[..., None], axis=1)[by_set]
        self._set_of_scene = set_of_scene
        self._start = np.searchsorted(set_of_scene[by_set], np.arange(len(self.sets) + 1))
        self.scenes_of_set = np.diff(self._start)
        self.names = [[self.bank.names[each] for each in np.unique(slot)] for slot in self.sets.T]
        self._own = [[self._own_friction(each) for each in slot] for slot in self.names]
        self.target = int(np.argmin([max(width[each] for each in slot) for slot in self.sets.T]))
        alone = int((self.scenes_of_set == 1).sum())
        if alone:
            warnings.warn(
                f"{alone} of {len(self.sets)} sets of objects have one scene, in which each of their worlds "
                "begins every time: `cluttergen generate --sets K` makes K sets with many scenes each",
                stacklevel=2,
            )

    def __deepcopy__(self, memo):
        # mjlab copies configurations whole; this never changes.
        return self

    def __reduce__(self):
        # mjlab's training writes configurations down.
        return Clutter, (str(self.bank.path.resolve()),)

    def entities(self, stand=None):
        """The support and an entity for each slot, by name, for `SceneCfg.entities`.

        Args:
          stand: `robot_pose()`, below which a pillar is drawn that nothing touches; none if not given.
        """
        entities = {"support": EntityCfg(spec_fn=partial(self._support, stand))}
        for slot, names in enumerate(self.names):
            away = (0.0, 0.0, _ABOVE + _AWAY * slot)
            most = max(len(self._vertices(name)) for name in names)
            specs = {name: partial(self._object, name, away, most, slot) for name in names}
            place = EntityCfg.InitialStateCfg(pos=away)
            if len(specs) == 1:
                entity = EntityCfg(spec_fn=specs[names[0]], init_state=place)
            else:
                assignment = partial(self._variants, slot)
                entity = VariantEntityCfg(variants=specs, assignment=assignment, init_state=place)
            entities[f"clutter_{slot}"] = entity
        return entities

    def events(self):
        """Friction and reset, for `ManagerBasedRlEnvCfg.events`; after what else places these entities."""
        return {
            "clutter_friction": EventTermCfg(func=self.set_friction, mode="startup"),
            "reset_clutter": EventTermCfg(func=self.reset, mode="reset"),
        }

    def simulation(self, **options):
        """The bank's time step, friction cone and solver; `options` replaces fields of SimulationCfg."""
        stability = self.bank.recipe["stability"]
        contact = self.bank.recipe["contact"]
        mujoco_cfg = MujocoCfg(
            timestep=stability["timestep"] / (2 if stability.get("both_detectors") else 1),
            cone="pyramidal" if _has_fault("mujoco-warp") else contact["cone"],
            impratio=contact["impratio"],
            iterations=contact["iterations"],
            gravity=(0.0, 0.0, -contact["gravity"]),
        )
        number = len(self.names) + 1
        room = {"nconmax": _CONTACTS * number, "njmax": _ROWS * number}
        return SimulationCfg(**{**room, "mujoco": mujoco_cfg, **options})

    def robot_pose(self, distance=None):
        """Where a robot stands: T_world_base, metres and wxyz, at the height of the top, looking along x.

        Args:
          distance: metres from the region's centre, against its x axis; if not given, 0.1 m beyond its side.
        """
        region = self.bank.region
        distance = region["half_extents"][0] + _GAP if distance is None else distance
        turn = region["yaw"]
        x, y = region["center"]
        place = x - distance * math.cos(turn), y - distance * math.sin(turn)
        height = float(self.bank.support.record["top"])
        return (*place, height), (math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2))

    def sets_of_worlds(self, num_envs):
        """i64[num_envs]: the set of objects that each world has."""
        return self._set_of_scene[np.arange(num_envs) % len(self._set_of_scene)]

    @requires_model_fields("geom_friction")
    def set_friction(self, env, env_ids=None):
        """Gives each world's objects their own friction, where they came with one; once, at the start."""
        sets = self.sets[self.sets_of_worlds(env.scene.num_envs)]
        usual = self.bank.recipe["contact"]["friction"]
        for slot, own in enumerate(self._own):
            if all(each is None for each in own):
                continue
            entity = env.scene[f"clutter_{slot}"]
            known = dict(zip(self.names[slot], own, strict=True))
            values = [known[self.bank.names[each]] for each in sets[:, slot]]
            values = [usual if each is None else _friction(usual, each) for each in values]
            friction = torch.as_tensor(np.array(values, np.float32), device=env.device)
            env.sim.model.geom_friction[:, entity.indexing.geom_ids] = friction[:, None]

    def reset(self, env, env_ids=None):
        """Puts these worlds' objects as in scenes of their sets, all equally likely; at rest."""
        if env_ids is None:
            env_ids = torch.arange(env.scene.num_envs, device=env.device)
        sets = self.sets_of_worlds(env.scene.num_envs)[env_ids.cpu().numpy()]
        start, end = (
            torch.as_tensor(each[sets], device=env.device)
            for each in (self._start[:-1], self._start[1:])
        )
        share = torch.rand(len(env_ids), device=env.device)
        scene = torch.minimum(start + (share * (end - start)).long(), end - 1)
        poses = torch.as_tensor(self.poses, device=env.device)[scene]
        origins = env.scene.env_origins[env_ids]
        poses[..., :3] += origins[:, None]
        rest = torch.zeros((len(env_ids), 6), device=env.device)
        upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=env.device).expand(len(env_ids), 4)
        env.scene["support"].write_mocap_pose_to_sim(
            torch.cat([origins, upright], dim=-1), env_ids=env_ids
        )
        for slot in range(len(self.names)):
            state = torch.cat([poses[:, slot], rest], dim=-1)
            env.scene[f"clutter_{slot}"].write_root_state_to_sim(state, env_ids=env_ids)

    def seen_from(self, env, robot="robot"):
        """f32[W, 3 N]: where all objects are in the frame of a robot's base, metres; an observation."""
        base = env.scene[robot].data
        places = [
            env.scene[f"clutter_{slot}"].data.root_link_pos_w - base.root_link_pos_w
            for slot in range(len(self.names))
        ]
        return torch.cat(
            [quat_apply_inverse(base.root_link_quat_w, each) for each in places], dim=-1
        )

    def _variants(self, slot, num_envs):
        objects = self.sets[self.sets_of_worlds(num_envs), slot]
        return [self.names[slot].index(self.bank.names[each]) for each in objects]

    def _support(self, stand):
        spec = _spec(self.bank.support_xml())
        if stand is not None:
            (x, y, height), turn = stand
            spec.body("support").add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=(x, y, height / 2),
                quat=turn,
                size=(0.08, 0.08, height / 2),
                rgba=(0.36, 0.37, 0.39, 1.0),
                contype=0,
                conaffinity=0,
            )
        return spec

    def _object(self, name, away, num_parts, slot):
        """An object with so many parts as each variant of its slot has, so that mjlab leaves none empty.

        mjlab merges the meshes of variants into one model, in which only those of the first have a convex
        hull, and where a variant has fewer parts, colliding geoms without a mesh remain. So parts are given
        by their points, of which MuJoCo makes a hull wherever they are, and specks take the empty places.
        """
        spec = _spec(self.bank.object_xml(name, _BODY))
        body = spec.body(_BODY)
        # Where nothing touches, since contacts are counted before the first reset.
        body.pos = away
        priority = (
            len(self.names) + 1 - slot if any(each is not None for each in self._own[slot]) else 0
        )
        parts = [geom for geom in body.geoms if geom.contype or geom.conaffinity]
        for geom, vertices in zip(parts, self._vertices(name), strict=True):
            geom.priority = priority
            mesh = spec.mesh(geom.meshname)
            mesh.file = ""
            mesh.uservert = vertices.ravel()
        inside = self._vertices(name)[0].mean(0)
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
        for number in range(len(parts), num_parts):
            speck = spec.add_mesh(name=f"speck-{number}")
            speck.uservert = (inside + _SPECK * corners).ravel()
            geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=speck.name, group=3)
            geom.mass = 0.0
            geom.priority = priority
        _paint(spec, body)
        return spec

    def _vertices(self, name):
        """f64[V, 3] of each collision part of an object, its frame."""
        name = name.partition("#")[0]
        if name not in self._parts:
            self._parts[name] = [_points(path) for path in self.bank.asset(name).parts]
        return self._parts[name]

    def _width(self, name):
        """Metres: the smaller side of an upright object's box, seen from above."""
        points = np.concatenate(self._vertices(name))
        return float(np.ptp(points[:, :2], axis=0).min())

    def _own_friction(self, name):
        return self.bank.asset(name.partition("#")[0]).record.get("friction")


def register(bank=None):
    """Registers a task for each arm of mjlab's, with its own names: "Cluttergen-Lift-Yam".

    The robot stands at `Clutter.robot_pose`, and lifts the object of slot `Clutter.target` out of the others,
    which it sees by their places (`seen_from`) to where a command tells; rewards, terminations and PPO are
    those of mjlab's own task of lifting a cube.

    Args:
      bank: a `Clutter`, or what it takes.

    Returns:
      The names of the tasks; those that are registered already are left as they are.
    """
    import mjlab.tasks  # noqa: F401 (it fills the registry)
    from mjlab.tasks.manipulation.config.yam.env_cfgs import yam_lift_cube_env_cfg

    clutter = bank if isinstance(bank, Clutter) else Clutter(bank)
    of_robot = {"Yam": ("Mjlab-Lift-Cube-Yam", yam_lift_cube_env_cfg)}
    made = []
    for robot, (own, make_cfg) in of_robot.items():
        name = f"Cluttergen-Lift-{robot}"
        made.append(name)
        if name in list_tasks():
            continue
        learning = load_rl_cfg(own)
        learning.experiment_name = name.lower().replace("-", "_")
        register_mjlab_task(
            name,
            _lift_cfg(clutter, make_cfg(play=False)),
            _lift_cfg(clutter, make_cfg(play=True)),
            learning,
            load_runner_cls(own),
        )
    return made


def _lift_cfg(clutter, cfg):
    """mjlab's environment of a cube with the objects of a bank in its place."""
    target = f"clutter_{clutter.target}"
    stand = clutter.robot_pose()
    cfg.scene.entities.pop("cube")
    robot = cfg.scene.entities["robot"]
    (x, y, top), turn = stand
    # mjlab's other tasks share this record, which lifts the base a little.
    home = robot.init_state
    robot.init_state = replace(home, pos=(x, y, top + home.pos[2]), rot=turn)
    cfg.scene.entities |= clutter.entities(stand)
    cfg.scene.env_spacing = 3.0
    cfg.events |= clutter.events()
    cfg.sim = clutter.simulation()
    cfg.decimation = max(1, round(_CONTROL / cfg.sim.mujoco.timestep))
    lift = cfg.commands["lift_height"]
    lift.entity_name = target
    # The reset has put it where it stands.
    lift.object_pose_range = None
    region = clutter.bank.region
    x, y = region["center"]
    side = 0.5 * min(region["half_extents"])
    goal = lift.target_position_range
    goal.x = (x - side, x + side)
    goal.y = (y - side, y + side)
    goal.z = (top + 0.15, top + 0.3)
    terms = [cfg.rewards[name] for name in ("lift", "lift_precise")]
    for group in ("actor", "critic"):
        seen = cfg.observations[group].terms
        seen["clutter"] = ObservationTermCfg(func=clutter.seen_from)
        terms += [term for term in seen.values() if "object_name" in term.params]
    for term in terms:
        term.params["object_name"] = target
    return cfg


def _friction(usual, own):
    """The three coefficients of an object with a friction of its own, beside the usual ones."""
    return [each * own / 0.5 for each in usual]


def _paint(spec, body):
    """Gives what is seen a material each: mjlab has one for each variant, but a geom's colour for all."""
    for number, geom in enumerate(body.geoms):
        if geom.contype or geom.conaffinity:
            continue
        made = spec.add_material(name=f"paint-{number}", rgba=geom.rgba)
        if geom.material:
            own = spec.material(geom.material)
            made.textures = own.textures
            for field in (
                "specular",
                "shininess",
                "reflectance",
                "metallic",
                "roughness",
                "emission",
            ):
                setattr(made, field, getattr(own, field))
        geom.material = made.name
        geom.rgba = _GREY


def _points(path):
    """f64[V, 3]: the vertices of an OBJ file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)


def _spec(text):
    # Options are those of the whole scene: `Clutter.simulation`.
    return mujoco.MjSpec.from_string(re.sub("<option.*</option>", "", text, flags=re.DOTALL))


def _main():
    """mjlab's own programs, with the tasks of the bank beside this file."""
    programs = ("train", "play")
    first = sys.argv[1] if len(sys.argv) > 1 else ""
    if first not in programs:
        usage = (
            f"python {Path(sys.argv[0]).name} train|play TASK ...; tasks: {', '.join(register())}"
        )
        if first in ("-h", "--help"):
            print(usage)
            return
        sys.exit(usage)
    program = sys.argv.pop(1)
    register()
    if program == "train":
        from mjlab.scripts.train import main
    else:
        from mjlab.scripts.play import main
    main()


if __name__ == "__main__":
    _main()
