"""Makes the film of docs/guide/robots.md: python docs/make_robot_film.py [FOLDER]

Each robot places one object; episodes and films are kept in FOLDER, out/robot_films if not given, where the
same command resumes. Extra `robot`, and robosuite's files for the UR5e; about six CPU-minutes.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

import cluttergen_jax as cg
from cluttergen_jax.rendering.sheet import contact_sheet
from cluttergen_jax.rendering.video import save_film

HERE = Path(__file__).parent
ROBOTS = ("panda", "panda_2f85", "ur5e_2f85", HERE.parent / "examples" / "own_robot" / "robot.yaml")
SIZE, FRAMES, FPS = (320, 240), 40, 5


def film_of(robot: str | Path, folder: Path) -> list[np.ndarray]:
    """u8[240, 320, 3], `FRAMES` frames of the robot's first episode, evenly spread."""
    out = folder / Path(robot).stem
    cg.robot_place(out, robot=robot, num_episodes=1, films=True)
    (film,) = (out / "place" / "films").glob("*.gif")
    with Image.open(film) as image:
        frames = [np.asarray(frame.convert("RGB").resize(SIZE)) for frame in ImageSequence.Iterator(image)]
    return [frames[k] for k in np.linspace(0, len(frames) - 1, FRAMES).round().astype(int)]


def main(folder: Path) -> None:
    """Draws all of them side by side."""
    names = [str(robot) if isinstance(robot, str) else "examples/own_robot" for robot in ROBOTS]
    films = [film_of(robot, folder) for robot in ROBOTS]
    frames = [contact_sheet(list(images), names, columns=2) for images in zip(*films, strict=True)]
    save_film(frames, HERE / "images" / "robots.gif", FPS)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out/robot_films"))
