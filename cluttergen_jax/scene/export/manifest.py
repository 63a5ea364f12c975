"""What travels with every export: where everything comes from, and on which terms it may be passed on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from cluttergen_jax.assets.object import ObjectAsset
from cluttergen_jax.assets.object_files import object_hash
from cluttergen_jax.assets.shape import Provenance
from cluttergen_jax.assets.support import SupportAsset
from cluttergen_jax.assets.support_file import support_hash
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.meshes import SUPPORT_FOLDER, object_folder
from cluttergen_jax.scene.export.scene_json import cameras_record, objects_record

MANIFEST = "MANIFEST.json"
LICENCES = "LICENSES.txt"


def scene_record(scene: Scene, file: str) -> dict[str, Any]:
    """One scene of the manifest: its file, how it came about, and what stands where (metres, wxyz)."""
    return {"file": file, **asdict(scene.origin), "objects": objects_record(scene)}


def manifest(
    format_name: str,
    generator: str,
    assets: Sequence[ObjectAsset],
    first: Scene,
    scenes: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    """The whole manifest as JSON values.

    Args:
      generator: version of this package.
      assets: each once.
      first: any of the scenes; support and physics are the same for all.
      scenes: from `scene_record`.
    """
    return {
        "format": 1,
        "kind": "cluttergen export",
        "export_format": format_name,
        "generator": {"cluttergen_jax": generator},
        "conventions": "metres, kilograms, seconds; quaternions wxyz; z up; origin on the floor",
        "physics": {"timestep": first.stability.timestep, **asdict(first.contact)},
        "support": _support_record(first.support),
        "assets": [_asset_record(asset) for asset in assets],
        **cameras_record(first),
        "scenes": list(scenes),
    }


def _asset_record(asset: ObjectAsset) -> dict[str, Any]:
    return {
        "name": asset.name,
        "label": asset.label,
        "folder": object_folder(asset.name),
        **asdict(asset.provenance),
        "hash": object_hash(asset),
        "tier": asset.tier,
        "mass": float(asset.mass),
        "flags": list(asset.flags),
    }


def _support_record(support: SupportAsset) -> dict[str, Any]:
    return {
        "name": support.name,
        "label": support.label,
        "folder": SUPPORT_FOLDER,
        **asdict(support.provenance),
        "hash": support_hash(support),
        "top": support.top,
        "region": asdict(support.region),
    }


def licences_text(support: SupportAsset, assets: Sequence[ObjectAsset], script: str) -> str:
    """Who made what and on which terms, in words, by licence."""
    things = [(f"support {support.name} ({support.label})", support.provenance)]
    things += [(f"object {asset.name} ({asset.label})", asset.provenance) for asset in assets]
    by_licence: dict[str, list[tuple[str, Provenance]]] = {}
    for name, provenance in things:
        by_licence.setdefault(provenance.licence or "not stated", []).append((name, provenance))
    lines = ["Terms on which the contents of this folder may be passed on, as far as they are known.", ""]
    for licence, members in sorted(by_licence.items()):
        lines.append(f"Licence: {licence}")
        for name, provenance in members:
            lines.append(f"  {name}: from {provenance.source or 'an unknown source'}")
            if provenance.attribution:
                lines.append(f"    attribution: {provenance.attribution}")
        lines.append("")
    if script:
        lines += [f"The script {script} is part of cluttergen_jax. Licence: Apache-2.0", ""]
    if "not stated" in by_licence:
        lines += ["Where no licence is stated, ask the owner before you pass it on.", ""]
    return "\n".join(lines)
