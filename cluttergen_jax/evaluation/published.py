"""The paper's setting, and what sets a row apart from it: Jia and Chen, "ClutterGen", CoRL 2024.

Ten objects on a cuboid table of 0.60 x 0.70 x 0.70 m unless said otherwise. Success is the paper's looser
count: only the current object is judged, the others are put back by hand. Stable steps are those of all
attempts of an object added up. The paper's numbers stand in the studies' modules.
"""

from __future__ import annotations

from typing import Any

GROUP_OF_POOL = {
    "dining": ("1, dining", "YCB scans"),
    "study": ("2, studying", "PartNet-Mobility and Objaverse"),
    "office": ("3, office", "PartNet-Mobility and Objaverse"),
    "kitchen": ("4, kitchen", "PartNet-Mobility and Objaverse"),
    "household": ("5, real", "own scans"),
}
"""The paper's group that each embedded pool stands for, and where its objects came from."""

IMPORTED = "paper_"
"""How names of pools begin that were imported from the authors' own files, such as `paper_dining`."""

TWINS = {"beta": "beta", "policy": "beta"}
"""Methods that are the paper's ClutterGen: with its own head, and with the one that a preset gives it."""

OBJECTS = 10
"""Of every scene."""

BUDGET = 2_500_000
"""Environment steps of each training run."""


def differs(row: dict[str, Any]) -> str:
    """What sets a row apart from the paper's; `differences` has the words behind it."""
    trial, policy = row["trial"], row.get("policy") or {}
    parts = ["engine", *(["assets"] if trial["pool"] in GROUP_OF_POOL else [])]
    if trial["num_objects"] != OBJECTS:
        parts.append(f"{trial['num_objects']} objects for {OBJECTS}")
    if trial["method"] == "random":
        parts.append("height")
    if policy.get("head") not in (None, "beta", "normal"):
        parts.append(f"head: {policy['head']}")
    if policy.get("attempts"):
        parts.append(f"{policy['attempts']:,} training attempts")
    return ", ".join(parts)


def differences(result: dict[str, Any]) -> tuple[str, ...]:
    """Notes below a table with a column of `differs`."""
    pools = dict.fromkeys(row["trial"]["pool"] for row in result["records"])
    groups = [(pool, *GROUP_OF_POOL[pool]) for pool in pools if pool in GROUP_OF_POOL]
    engine = f"engine: MuJoCo {result['machine']['versions']['mujoco']} for PyBullet"
    stands = "; ".join(f"{pool} for group {group} ({assets})" for pool, group, assets in groups)
    return (
        f"what differs from the paper: {engine}; its policies had {BUDGET:,} training attempts",
        *([f"assets: modelled objects, {stands}"] if groups else []),
        "height: `random` lets go at the object's own resting height",
    )
