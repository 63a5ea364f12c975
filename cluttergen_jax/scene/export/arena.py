"""Isaac Lab-Arena: scenes of the same objects as rows of one file of layouts, and their environment's YAML.

As its 0.4 reads them (docs: Relations and Strategies, Recorded Layouts): every row has the same objects;
positions in metres, quaternions xyzw; an object's key is its id in the YAML.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import yaml

from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.meshes import identifier, identifiers

_VARIATION = "scene.relation_placement"
_SUPPORT = "table"
_ROBOT_DISTANCE = 0.525
"""Metres from the region's centre to the arm's base, as our own arm stands."""
_BESIDE = 0.225
"""Metres from the region's edge to the arm's base, at least."""
_EPISODE = 10.0


def write_layout(folder: Path, scene: Scene) -> None:
    """Adds a scene to `layouts/` of an export: a row in the file of its objects, and their environment."""
    text = _environment(scene)
    name = f"{len(scene.names)}-objects-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    layouts = folder / "layouts"
    layouts.mkdir(exist_ok=True)
    (layouts / f"{name}.yaml").write_text(
        f"env_name: cluttergen_{identifier(name)}\n{text}", encoding="utf-8"
    )
    with (layouts / f"{name}.jsonl").open("a", encoding="utf-8") as rows:
        rows.write(json.dumps(_row(scene)) + "\n")


def _environment(scene: Scene) -> str:
    region = scene.support.region
    # Beyond the region, however large and turned it is.
    half = np.abs([np.cos(region.yaw), np.sin(region.yaw)]) @ region.half_extents
    away = max(_ROBOT_DISTANCE, float(half) + _BESIDE)
    base = [region.center[0] - away, region.center[1], scene.support.top]
    ids = identifiers(scene.names)
    things = sorted(zip(ids, scene.objects, strict=True), key=lambda thing: thing[0])
    record = {
        "embodiment": {
            "id": "robot",
            "registry_name": "franka_ik",
            "params": {"initial_pose": {"position_xyz": [float(x) for x in base]}},
        },
        "background": {"id": _SUPPORT, "registry_name": "cluttergen_support"},
        "objects": [
            {"id": own, "registry_name": registry_name(asset.name)} for own, asset in things
        ],
        "relations": [
            {"kind": "is_anchor", "subject": _SUPPORT},
            *({"kind": "on", "subject": own, "reference": _SUPPORT} for own, _ in things),
        ],
        "task": {
            "composition": "atomic",
            "description": "No task.",
            "subtasks": [{"kind": "NoTask", "params": {"episode_length_s": _EPISODE}}],
        },
    }
    return yaml.safe_dump(record, sort_keys=False)


def registry_name(name: str) -> str:
    """An asset's name in Arena's registry; as `cluttergen_arena.py` makes it, distinct for distinct ones."""
    plain = identifier(f"cluttergen_{name}")
    is_same = plain == f"cluttergen_{name}"
    return plain if is_same else f"{plain}_{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def _row(scene: Scene) -> dict[str, object]:
    origin = scene.origin
    poses = {
        own: {
            "position_xyz": pose[:3].tolist(),
            "rotation_xyzw": [*pose[4:].tolist(), float(pose[3])],
        }
        for own, pose in zip(identifiers(scene.names), scene.poses, strict=True)
    }
    check = {"passed": origin.is_success, "simulator": "mujoco", "max_drift_m": origin.drift}
    placement = {
        "layout_id": f"layout_{origin.index:06d}",
        "source": "settled",
        "poses": poses,
        "validation": {"post_physics": {"cluttergen_final_check": check}},
    }
    return {"variations": {_VARIATION: placement}}
