"""A bank of scenes in mjlab: other objects in each world, and a reset that puts them as in a scene.

    from cluttergen_mjlab import Clutter       # beside bank_reader.py; needs mjlab 1.6 and pyarrow

    clutter = Clutter("bank")
    cfg.scene.entities |= clutter.entities()   # "support", "clutter_0", "clutter_1", ...
    cfg.events |= clutter.events()             # "reset_clutter"
    cfg.sim = clutter.simulation()             # the contacts that the scenes were checked with

A world keeps its objects: those of scene (its number modulo the number of scenes). A reset draws among all
scenes of the same objects, so that where every scene has others, a world has one scene.
"""

import re
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import torch
from bank_reader import Bank, BankError
from mjlab.entity import EntityCfg
from mjlab.entity.variants import VariantEntityCfg
from mjlab.managers.event_manager import EventTermCfg
from mjlab.sim.sim import MujocoCfg, SimulationCfg

_BODY = "object"
# Metres: where objects are before the first reset, and between two.
_ABOVE = 3.0
_AWAY = 1.0


class Clutter:
    """The scenes of a bank that succeeded, all of N objects.

    Args:
      bank: its folder; this file's own, or its `bank`, if not given.

    Attributes:
      names: for each slot, the objects that occur in it.
      sets: i64[C, N], the sets of objects that scenes have, numbers in `bank.names`.
      poses: f32[S, N, 7], of scenes sorted by set, world frame of a scene, metres, wxyz.
    """

    def __init__(self, bank=None):
        folder = Path(__file__).resolve().parent
        self.bank = Bank(bank or (folder / "bank" if (folder / "bank").is_dir() else folder))
        arrays = self.bank.arrays
        if not arrays.is_placed.all():
            raise BankError("scenes of different numbers of objects", "the same number in each")
        order = np.argsort(arrays.object_index, axis=1, kind="stable")
        objects = np.take_along_axis(arrays.object_index, order, axis=1)
        self.sets, set_of_scene = np.unique(objects, axis=0, return_inverse=True)
        set_of_scene = set_of_scene.ravel()
        by_set = np.argsort(set_of_scene, kind="stable")
        self.poses = np.take_along_axis(arrays.poses, order[..., None], axis=1)[by_set]
        self._set_of_scene = set_of_scene
        self._start = np.searchsorted(set_of_scene[by_set], np.arange(len(self.sets) + 1))
        self.names = [[self.bank.names[each] for each in np.unique(slot)] for slot in self.sets.T]

    def __deepcopy__(self, memo):
        # mjlab copies configurations whole; this never changes.
        return self

    def entities(self):
        """The support and an entity for each slot, by name, for `SceneCfg.entities`."""
        entities = {"support": EntityCfg(spec_fn=lambda: _spec(self.bank.support_xml()))}
        for slot, names in enumerate(self.names):
            away = (0.0, 0.0, _ABOVE + _AWAY * slot)
            specs = {name: partial(self._object, name, away) for name in names}
            place = EntityCfg.InitialStateCfg(pos=away)
            if len(specs) == 1:
                entity = EntityCfg(spec_fn=specs[names[0]], init_state=place)
            else:
                assignment = partial(self._variants, slot)
                entity = VariantEntityCfg(variants=specs, assignment=assignment, init_state=place)
            entities[f"clutter_{slot}"] = entity
        return entities

    def events(self):
        """The reset, for `ManagerBasedRlEnvCfg.events`; it comes after what else places these entities."""
        return {"reset_clutter": EventTermCfg(func=self.reset, mode="reset")}

    def simulation(self, **options):
        """The bank's time step, friction cone and solver; `options` replaces fields of SimulationCfg."""
        stability = self.bank.recipe["stability"]
        contact = self.bank.recipe["contact"]
        mujoco_cfg = MujocoCfg(
            timestep=stability["timestep"] / (2 if stability.get("both_detectors") else 1),
            cone=contact["cone"],
            impratio=contact["impratio"],
            iterations=contact["iterations"],
            gravity=(0.0, 0.0, -contact["gravity"]),
        )
        return SimulationCfg(**{"mujoco": mujoco_cfg, **options})

    def sets_of_worlds(self, num_envs):
        """i64[num_envs]: the set of objects that each world has."""
        return self._set_of_scene[np.arange(num_envs) % len(self._set_of_scene)]

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

    def _variants(self, slot, num_envs):
        objects = self.sets[self.sets_of_worlds(num_envs), slot]
        return [self.names[slot].index(self.bank.names[each]) for each in objects]

    def _object(self, name, away):
        spec = _spec(self.bank.object_xml(name, _BODY))
        # Where nothing touches, since contacts are counted before the first reset.
        spec.body(_BODY).pos = away
        return spec


def _spec(text):
    # Options are those of the whole scene: `Clutter.simulation`.
    return mujoco.MjSpec.from_string(re.sub("<option.*</option>", "", text, flags=re.DOTALL))
