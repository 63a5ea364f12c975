"""Makes the pages and films of docs/robots, one of each a robot: python docs/make_robots.py [FOLDER]

Each robot places and rearranges objects, 20 episodes of either; they are kept in FOLDER, out/robots if not
given, where the same command resumes. Extra `robot`, and robosuite's files for the UR5e. About five
CPU-minutes a robot, and three more where its gripper's grasps are not known yet.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageSequence

import cluttergen_jax as cg
from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.evaluation.records import cpu_model

HERE = Path(__file__).parent
OWN = "examples/own_robot/robot.yaml"
ROBOTS = {
    "panda": "A Franka Panda with Franka's own hand, as MuJoCo Menagerie models them.",
    "panda_2f85": "A Franka Panda with a Robotiq 2F-85 in place of its own hand, both as MuJoCo Menagerie "
    "models them.",
    "ur5e_2f85": "A Universal Robots UR5e as robosuite models it, with Menagerie's Robotiq 2F-85. It needs "
    "`pip install --no-deps robosuite`, of which only files are read.",
    OWN: "An arm of capsules with a gripper of boxes: the example to begin your own from.",
}
"""Each robot, and what it is."""
NUM_EPISODES = 20
SIZE = (320, 240)
COLOURS = 48
LONGEST = 60


def save_small(film: Path, path: Path) -> None:
    """A film in fewer frames, smaller and in few colours, as long as before."""
    with Image.open(film) as image:
        frames = ImageSequence.Iterator(image)
        shown = [
            (each.info.get("duration", 100), each.convert("RGB").resize(SIZE)) for each in frames
        ]
    kept = np.linspace(0, len(shown) - 1, min(LONGEST, len(shown))).round().astype(int)
    duration = sum(lasts for lasts, _ in shown) / len(kept)
    first, *others = [shown[each][1].quantize(COLOURS, dither=Image.Dither.NONE) for each in kept]
    first.save(
        path, save_all=True, append_images=others, duration=round(duration), loop=0, optimize=True
    )


def facts_of(robot: RobotDescription) -> list[tuple[str, str]]:
    """What a robot is, as name and value."""
    arm = robot.arm
    gripper = robot.gripper
    low = min(arm.speed)
    high = max(arm.speed)
    speed = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    return [
        ("joints of the arm", str(len(arm.joints))),
        ("fastest joints", f"{speed} rad/s"),
        ("the gripper opens to", f"{2e3 * gripper_of(robot).max_opening:.0f} mm"),
        ("base to the region's centre", f"{robot.distance:g} m"),
        ("arm", _where(arm.package, arm.file)),
        ("gripper", _where(gripper.package, gripper.file)),
    ]


def _where(package: str, file: str) -> str:
    if not package:
        return f"`{Path(file).name}` beside the description"
    return f"`{'/'.join(Path(file).parts[-2:])}` of the package `{package}`"


def _line(what: str, made: Any, more: str, command: str) -> str:
    rows = made.rows
    success = f"{sum(row.is_success for row in rows)} of {len(rows)}{more}"
    causes = "".join(f" ({text})" for text in made.causes())
    seconds, cpu = (np.mean([getattr(row, name) for row in rows]) for name in ("seconds", "cpu"))
    return f"| {what} | {success}{causes} | {seconds:.0f} | {cpu:.1f} | `{command}` |"


def page_of(robot: str, folder: Path) -> str:
    """The page of a robot, its film made."""
    name = Path(robot).parent.name if robot == OWN else robot
    given = str(HERE.parent / OWN) if robot == OWN else robot
    placed = cg.robot.place(folder / name, robot=given, num_episodes=NUM_EPISODES, films=True)
    moved = cg.rearrange(
        folder / name / "rearrange", robot=given, num_episodes=NUM_EPISODES, seed=40
    )
    first = next(index for index, row in enumerate(placed.rows) if row.is_success)
    save_small(folder / name / f"place/films/success-{first}.gif", HERE / f"robots/{name}.gif")
    place, rearrange = (
        f"cluttergen {command} --robot {robot} --num-episodes {NUM_EPISODES}"
        for command in ("robot place", "rearrange --seed 40")
    )
    right = [each for row in moved.rows for each in row.right]
    measured = "\n".join(
        [
            _line("placing among seven others", placed, "", place),
            _line(
                "rearranging five objects",
                moved,
                f"; {sum(right)} of {len(right)} objects",
                rearrange,
            ),
        ]
    )
    facts = "\n".join(f"| {key} | {value} |" for key, value in facts_of(find_robot(given)))
    source = OWN if robot == OWN else f"cluttergen_jax/downstream/robot/robots/{robot}.yaml"
    return f"""# {name}

{ROBOTS[robot]}

![{name} places an object among others]({name}.gif)

| | |
|---|---|
{facts}

Its description: [{Path(source).name}](../../{source}).

| household, true poses | success | s simulated | CPU-s | command |
|---|---|---|---|---|
{measured}

Means of an episode; {datetime.date.today().isoformat()}, {cpu_model()}. What counts as a success:
[words and numbers](../contract.md). Other robots and your own: [guide](../guide/robots.md).
This page and its film: `python docs/make_robots.py`.
"""


def main(folder: Path) -> None:
    """Makes all pages."""
    (HERE / "robots").mkdir(exist_ok=True)
    for robot in ROBOTS:
        name = Path(robot).parent.name if robot == OWN else robot
        (HERE / f"robots/{name}.md").write_text(page_of(robot, folder), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out/robots"))
