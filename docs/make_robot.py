"""Makes the pictures of docs/guide/robot.md and rearrange.md: python docs/make_robot.py (some minutes)."""

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

import cluttergen_jax as cg
from cluttergen_jax.rendering.sheet import contact_sheet

HERE = Path(__file__).parent / "images"
COLOURS = 128
MOMENTS = 6


def strip(film: Path) -> np.ndarray:
    """Moments of a film, evenly apart, the last one included."""
    with Image.open(film) as frames:
        images = [np.asarray(each.convert("RGB")) for each in ImageSequence.all_frames(frames)]
    chosen = np.linspace(0, len(images) - 1, MOMENTS).round().astype(int)
    return contact_sheet([images[each] for each in chosen], columns=3)


def save(image: np.ndarray, name: str) -> None:
    """A small PNG, in few colours."""
    few = Image.fromarray(image).quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(HERE / name, optimize=True)


def main() -> None:
    """Runs an episode of each kind and draws it."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        for found in (
            cg.robot.place(out / "robot", num_episodes=1, placer="none", films=True),
            cg.rearrange(out / "rearrange", num_episodes=1, films=True, show_layouts=True),
        ):
            assert found.rows[0].is_success, found
        save(strip(out / "robot/place/films/success-0.gif"), "robot_place.png")
        save(strip(out / "rearrange/paper/films/success-0.gif"), "rearrange.png")
        with Image.open(out / "rearrange/paper/layouts-0.png") as sheet:
            save(np.asarray(sheet), "layouts.png")
        cg.robot.grasps("household", picture=out / "grasps.png")
        with Image.open(out / "grasps.png") as sheet:
            save(np.asarray(sheet), "grasps.png")


if __name__ == "__main__":
    main()
