"""Draws an exported SDFormat world in Drake, from 0.3 m above its table; needs pydrake and OpenGL.

See test_textures_exported: 200 x 200 pixels, 40 degrees wide, straight down on the origin, x to the right.
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from pydrake.all import (
    AddMultibodyPlantSceneGraph,
    CameraInfo,
    ClippingRange,
    ColorRenderCamera,
    DiagramBuilder,
    MakeRenderEngineVtk,
    Parser,
    RenderCameraCore,
    RenderEngineVtkParams,
    RigidTransform,
    RotationMatrix,
)

folder, out = Path(sys.argv[1]), sys.argv[2]
manifest = json.loads((folder / "MANIFEST.json").read_text())
builder = DiagramBuilder()
plant, graph = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
Parser(plant).AddModels(str(folder / manifest["scenes"][0]["file"]))
plant.Finalize()
graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
context = builder.Build().CreateDefaultContext()
query = graph.get_query_output_port().Eval(graph.GetMyContextFromRoot(context))
lens = RenderCameraCore("vtk", CameraInfo(200, 200, np.radians(40)), ClippingRange(0.01, 5), RigidTransform())
above = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, manifest["support"]["top"] + 0.3])
image = query.RenderColorImage(ColorRenderCamera(lens), graph.world_frame_id(), above)
Image.fromarray(image.data[..., :3]).save(out)
