"""The card of a folder of pairs: what it holds, how it was made, and whose assets are in it."""

from __future__ import annotations

from typing import Any

import numpy as np

from cluttergen_jax.assets import public_name
from cluttergen_jax.downstream.placer.pairs.candidate_draw import PARTIAL_MAP, RANDOM, TRUE_MAP
from cluttergen_jax.downstream.placer.pairs.store import SCHEMA, PairSet
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.scene import Bank, assets_section, front_matter, write_unless_own
from cluttergen_jax.tables import markdown_table
from cluttergen_jax.types import Verdict

_SOURCES = {TRUE_MAP: "true map", PARTIAL_MAP: "partial map", RANDOM: "random"}
_COLUMNS = {
    "pair": "number in its split",
    "scene": "number of the scene in its bank",
    "slot": "which of the scene's objects is to be placed, in the order of placement",
    "object": "its name",
    "pool": "the pool that the scene was made of",
    "num_standing": "objects that stand already",
    "camera_K": "intrinsics, 3 x 3, row by row; a pixel's middle is at (column + .5, row + .5)",
    "T_region_camera": "the camera's pose, 4 x 4, row by row, metres; x right, y down, z forward",
    "width": "pixels",
    "height": "pixels",
    "depth": "u16, little-endian, row by row: millimetres of depth, 0 where nothing is, no noise",
    "labels": "u8, row by row: 0 the floor, 1 the support, 2 + k the k-th standing object",
    "standing": "names of the objects that stand, in the order of placement",
    "standing_poses": "T_region_object of each, metres and quaternion wxyz",
    "target_pose": "likewise, where the scene's own object rests",
    "candidate": "32 poses x, y, z and yaw of T_region_object at which the object is let go, metres, radians",
    "candidate_source": f"how each was found: {', '.join(f'{k} {v}' for k, v in _SOURCES.items())}",
    "candidate_verdict": "what became of it: "
    + ", ".join(f"{int(verdict)} {verdict.label}" for verdict in Verdict if verdict >= 0),
}

_ABOUT = (
    "Pairs for stable placement: what one depth camera sees of a partial scene, where the scene's next "
    "object rests, and 32 poses at which it was let go, with what became of each in physics. Scenes of "
    "different splits have different keys."
)
_FRAME = "The region frame has its origin at the middle of the queried region on the support's top, z up."


def write_card(pairs: PairSet) -> None:
    """Writes README.md, unless the user has one of their own there."""
    write_unless_own(pairs.path, lambda: card_text(pairs))


def card_text(pairs: PairSet) -> str:
    """The card as Markdown."""
    bank = Bank(pairs.path, {"assets": pairs.record["assets"]})
    assets = [bank.object(name) for name in sorted(pairs.record["assets"]["objects"])]
    files = [f"{{split: {split}, path: '{split}-*.parquet'}}" for split in pairs.splits]
    head = front_matter(
        [*(asset.provenance.licence for asset in assets), bank.support.provenance.licence],
        ["robotics", "simulation", "mujoco", "tabletop", "placement"],
        "stable placement pairs",
        f"[{', '.join(files)}]",
    )
    columns = markdown_table(
        ("column", "type", "meaning"),
        [(f"`{f.name}`", f"`{f.type}`", _COLUMNS[f.name]) for f in SCHEMA],
    )
    sections = [
        head,
        f"# {pairs.path.resolve().name}\n\n{_ABOUT}",
        *(_split(pairs, split) for split in pairs.splits),
        f"## Columns\n\n{columns}\n\n{_FRAME}",
        assets_section(assets, bank.support),
    ]
    return "\n\n".join(sections) + "\n"


def _split(pairs: PairSet, split: str) -> str:
    made = pairs.split(split)
    recipe: dict[str, Any] = made["recipe"]
    verdicts = np.concatenate(
        [np.array(rows["candidate_verdict"].to_pylist(), np.uint8) for rows in pairs.tables(split)]
    )
    shares = [(verdict.label, (verdicts == verdict).mean()) for verdict in Verdict if verdict >= 0]
    rows = {
        "pairs": made["num_pairs"],
        "scenes that stand in its bank": made["num_scenes"],
        "seed of the bank": f"{recipe.get('seed')} ({split}: from {SPLITS[split]} on)",
        "seed of the pairs": f"{made['seed']} (likewise)",
        "camera": made["camera"],
        "pool": public_name(str(recipe.get("pool"))),
        "method of the scenes": recipe.get("method"),
        "versions": ", ".join(f"{name} {number}" for name, number in made["versions"].items()),
        "verdicts of candidates": ", ".join(
            f"{name} {share:.1%}" for name, share in shares if share
        ),
    }
    return "\n".join(
        [f"## Split `{split}`", "", *(f"- {name}: {value}" for name, value in rows.items())]
    )
