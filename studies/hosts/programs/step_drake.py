"""10 s of exported scenes in Drake, by SAP: python step_drake.py EXPORT SECONDS NUM_SCENES.

Prints JSON; see step_dm_control.py.
"""

import json
import sys
from pathlib import Path

import numpy as np
from pydrake.all import (
    AddMultibodyPlant,
    DiagramBuilder,
    MultibodyPlantConfig,
    Parser,
    Simulator,
)

folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
num_scenes = int(sys.argv[3])
_LOOKS = 20

moves = []
is_finite = True
for path in sorted(folder.glob("scenes/*.sdf"))[:num_scenes]:
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=1 / 240, discrete_contact_approximation="sap")
    plant, _ = AddMultibodyPlant(config, builder)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyContextFromRoot(simulator.get_mutable_context())
    bodies = [plant.get_body(each) for each in plant.GetFloatingBaseBodies()]

    def positions(plant=plant, context=context, bodies=bodies):
        """f64[N, 3]."""
        return np.array([plant.EvalBodyPoseInWorld(context, body).translation() for body in bodies])

    start = positions()
    move = 0.0
    for look in range(_LOOKS):
        simulator.AdvanceTo((look + 1) * seconds / _LOOKS)
        now = positions()
        is_finite &= bool(np.isfinite(now).all())
        move = max(move, float(np.linalg.norm(now - start, axis=1).max()))
    moves.append(move)
    print(f"{len(moves)} of {num_scenes}", file=sys.stderr, flush=True)
print(json.dumps({"moves": moves, "is_finite": is_finite, "num_worlds": 1}))
