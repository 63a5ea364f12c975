"""Makes the picture of docs/guide/judge.md: python docs/make_judge.py (a minute on two cores).

A scene is shaken by hand, judged as anybody's file, and repaired.
"""

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import cluttergen_jax as cg
from cluttergen_jax.files import file_whole
from cluttergen_jax.rendering import contact_sheet

HERE = Path(__file__).parent / "images"
SHIFT = 0.03
"""Standard deviation of the shake along each axis, metres."""
WIDTH = 640
HEIGHT = 480
GAP = 8
"""Pixels of each picture of the judge's, and between them."""
SHOWN = 1200
SEED = 4


def layout_of(scene: cg.Scene) -> dict[str, object]:
    """What `cluttergen repair` reads."""
    return {
        "pool": "dining",
        "support": "table",
        "objects": [
            {"name": asset.name, "position": list(pose[:3]), "quaternion_wxyz": list(pose[3:])}
            for asset, pose in zip(scene.objects, scene.poses, strict=True)
        ],
    }


def main() -> None:
    """Shakes, judges, repairs and draws."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        bank = cg.generate(out / "bank", pool="dining", num_scenes=1, seed=SEED, render=False)
        scene = bank[0]
        rng = np.random.default_rng(0)
        poses = np.array(scene.poses)
        poses[:, :3] += rng.normal(0, SHIFT, (len(poses), 3)) * (1, 1, 0.5)
        broken = replace(scene, poses=poses)
        cg.export(broken, out / "broken")
        cg.judge(out / "broken", out=out / "judged", detectors=("native",))
        layout = out / "layout.json"
        layout.write_text(json.dumps(layout_of(broken)))
        repaired = cg.repair(layout, out / "fixed", max_shift=0.1)
        with Image.open(out / "judged" / "worst.png") as judged:
            start_and_end = [
                np.asarray(judged.convert("RGB").crop((left, GAP, left + WIDTH, GAP + HEIGHT)))
                for left in (GAP, 2 * GAP + WIDTH)
            ]
        images = [
            *start_and_end,
            np.asarray(cg.read_bank(repaired.path)[0].picture(size=(WIDTH, HEIGHT))),
        ]
        captions = ["given; red: what moves", "after a minute", "repaired"]
        sheet = Image.fromarray(contact_sheet(images, captions, columns=3))
        with file_whole(HERE / "judge.png") as fresh:
            sheet.resize((SHOWN, sheet.height * SHOWN // sheet.width)).save(fresh, "PNG")


if __name__ == "__main__":
    main()
