"""Reads a scene in Drake, as a world or directives; needs pydrake. Prints JSON: see test_export_peers."""

import json
import logging
import sys
from pathlib import Path

from pydrake.all import AddMultibodyPlant, DiagramBuilder, MultibodyPlantConfig, Parser, Simulator

folder = Path(sys.argv[1])
seconds = float(sys.argv[2])
ending = sys.argv[3] if len(sys.argv) > 3 else ".sdf"
own = json.loads((folder / "MANIFEST.json").read_text())["scenes"][0]
warnings = []
logging.getLogger("drake").addFilter(lambda record: warnings.append(record.getMessage()) or True)
builder = DiagramBuilder()
config = MultibodyPlantConfig(time_step=1 / 240, discrete_contact_approximation="sap")
plant, scene_graph = AddMultibodyPlant(config, builder)
parser = Parser(plant)
parser.package_map().AddPackageXml(str(folder / "package.xml"))
parser.AddModels(str((folder / own["file"]).with_suffix(ending)))
plant.Finalize()
simulator = Simulator(builder.Build())
context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
names = [entry["name"] for entry in own["objects"]]
bodies = {name: plant.GetBodyByName("body", plant.GetModelInstanceByName(name)) for name in names}


def poses():
    """Position and quaternion wxyz of every object."""
    frames = {name: plant.EvalBodyPoseInWorld(context, body) for name, body in bodies.items()}
    return {n: [*X.translation(), *X.rotation().ToQuaternion().wxyz()] for n, X in frames.items()}


def inertia(body):
    """The tensor about the centre of mass, object axes."""
    about = body.CalcSpatialInertiaInBodyFrame(context)
    return about.Shift(about.get_com()).CalcRotationalInertia().CopyToFullMatrix3().tolist()


def friction(body):
    """Those that its parts have, sorted."""
    inspector = scene_graph.model_inspector()
    own = [
        inspector.GetProximityProperties(part).GetProperty("material", "coulomb_friction")
        for part in plant.GetCollisionGeometriesForBody(body)
    ]
    return sorted(
        {value for each in own for value in (each.static_friction(), each.dynamic_friction())}
    )


report = {
    "warnings": warnings,
    "friction": {name: friction(body) for name, body in bodies.items()},
    "mass": {name: body.get_mass(context) for name, body in bodies.items()},
    "inertia": {name: inertia(body) for name, body in bodies.items()},
    "before": poses(),
}
simulator.Initialize()
simulator.AdvanceTo(seconds)
print(json.dumps(report | {"after": poses()}))
