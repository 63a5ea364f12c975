"""What a camera sees of a scene: cameras, depth and labels by rays, partial height maps; no JAX."""

from cluttergen_jax.sensing.camera import (
    REALSENSE_FOCAL,
    Camera,
    CameraPlan,
    find_preset,
    free,
    intrinsics,
    overhead,
    parse_cameras,
    realsense_focal,
)
from cluttergen_jax.sensing.partial import Grid, PartialMap, level_camera, merge_maps
from cluttergen_jax.sensing.rays import (
    FIRST_OBJECT,
    FLOOR,
    SUPPORT,
    DepthImage,
    Instance,
    InstanceSensor,
    RaySensor,
    View,
    cast_rays,
    sensed_model,
)

__all__ = [
    "FIRST_OBJECT",
    "FLOOR",
    "REALSENSE_FOCAL",
    "SUPPORT",
    "Camera",
    "CameraPlan",
    "DepthImage",
    "Grid",
    "Instance",
    "InstanceSensor",
    "PartialMap",
    "RaySensor",
    "View",
    "cast_rays",
    "find_preset",
    "free",
    "intrinsics",
    "level_camera",
    "merge_maps",
    "overhead",
    "parse_cameras",
    "realsense_focal",
    "sensed_model",
]
