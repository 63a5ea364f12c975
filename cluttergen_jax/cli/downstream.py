"""The commands about what scenes are for: placers, a robot arm."""

from __future__ import annotations

from functools import partial

from tyro.conf import Positional

from cluttergen_jax.cli.options import Group, Options, command
from cluttergen_jax.downstream.environments.api import rearrange, robot_place, robot_record
from cluttergen_jax.downstream.placer.api import placer_data, placer_eval, placer_train
from cluttergen_jax.downstream.robot.api import (
    clear_clutter,
    grasp_dataset,
    robot_check,
    robot_grasps,
)
from cluttergen_jax.downstream.words import PadSource, RobotObserver
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.spec import in_groups


@command(placer_data, bank=Positional[str | None])  # type: ignore[misc]
def make_pairs(options: Options) -> None:
    """Make pairs to learn stable placement from. Rerun to resume.

    A pair is one depth image of the first objects of a scene, the true pose of the next object, and 32
    labelled candidate poses.

    Example: `cluttergen placer data --num-scenes 500 --pool household --out pairs`
    """
    pairs = options.call(placer_data)
    for split in pairs.splits:
        print(f"pairs      {pairs.split(split)['num_pairs']} of {split} in {pairs.path}")


@command(placer_train, data=Positional[tuple[str, ...]])
def train_placer(options: Options) -> None:
    """Train a placer on pairs. Rerun to resume.

    Example: `cluttergen placer train pairs --head scored --out runs/placer`
    """
    if not options.data:
        raise ConfigError("no folder of pairs", "one or more", "cluttergen placer train pairs")
    options.call(placer_train)


@command(placer_eval, data=Positional[str], placers=tuple[str, ...])
def compare_placers(options: Options) -> None:
    """Compare placers: the success rate of their proposals, strictly judged.

    Every row is kept under `results` in the folder `--out`: rerun to resume.

    Example: `cluttergen placer eval pairs --placers random geometry --noise 0 1`
    """
    print(options.call(placer_eval, out=options.out or "out/placer"))


run_placer = Group(
    """Stable placement from one camera's view: `placer data`, `placer train` and `placer eval`.

    Example: `cluttergen placer data --num-scenes 500 --pool household --out pairs`
    """,
    {"data": make_pairs, "train": train_placer, "eval": compare_placers},
)


@command(robot_grasps, pool=Positional[str], robot=str, pads=float | PadSource | None)
def find_grasps(options: Options) -> None:
    """Find grasps of a pool's objects for the hand of a robot, each tested in MuJoCo (extra `robot`).

    Example: `cluttergen robot grasps household --num-grasps 64`
    """
    print(options.call(robot_grasps))


@command(
    in_groups(
        what="task pool num_objects",
        where="support region",
        how_many="num_episodes seed",
        files="out record record_format record_cameras films film",
        machine="num_threads",
    )(robot_place),
    bank=Positional[str | None],  # type: ignore[misc]
    robot=str,
    placer=str,
    grasps=str | None,
    everyday="task robot placer num_episodes pool num_objects support method record films seed out",
)
def move_objects(options: Options) -> None:
    """Let a simulated robot arm put objects into scenes, or lift them out of them (extra `robot`).

    Example: `cluttergen robot place --pool household --num-episodes 40`
    """
    print(options.call(robot_place))


@command(robot_record, bank=Positional[str], robot=str)
def record_demonstrations(options: Options) -> None:
    """Record demonstrations in an environment, for LeRobot or robomimic (extras `robot`, `gym`).

    Example: `cluttergen robot record bank --num-episodes 50 --out demos`
    """
    print(options.call(robot_record))


@command(grasp_dataset, bank=Positional[str], robot=str)
def make_grasp_dataset(options: Options) -> None:
    """Make a dataset of labelled grasps in the scenes of a bank, failures kept (extra `robot`).

    Example: `cluttergen robot dataset bank --out grasps`
    """
    print(options.call(grasp_dataset))


@command(robot_check, robot=Positional[str])
def try_robot(options: Options) -> int:
    """Try the description of a robot: its hand, its reach, a cube (extra `robot`). Exit status 1 if it fails.

    Example: `cluttergen robot check examples/own_robot/robot.yaml --picture robot.png`
    """
    found = options.call(robot_check)
    print(found)
    return 0 if found.is_good else 1


@command(
    clear_clutter,
    bank=Positional[str],
    robot=str,
    proposer=str,
    pads=float | PadSource | None,
)
def clear_piles(options: Options) -> None:
    """Clear the piles of a bank grasp by grasp, in rounds by VGN's rule or a stricter one (extra `robot`).

    Example: `cluttergen robot clear piles --rule vgn --num-rounds 40`
    """
    print(options.call(clear_clutter))


run_robot = Group(
    """A robot arm in simulation: grasps, episodes, recordings, grasp data, rounds in clutter, checks.

    Example: `cluttergen robot grasps household`
    """,
    {
        "grasps": find_grasps,
        "place": move_objects,
        "record": record_demonstrations,
        "dataset": make_grasp_dataset,
        "clear": clear_piles,
        "check": try_robot,
    },
)


@command(
    in_groups(
        what="setting pool goals",
        where="support target cameras",
        how_many="num_episodes num_layouts seed",
        files="out show_layouts record record_format record_cameras films film",
        machine="num_threads host port browser",
    )(rearrange),
    bank=Positional[str | None],  # type: ignore[misc]
    observer=RobotObserver,
    grasps=str | None,
    target=str | None,
    robot=str,
    everyday="setting num_episodes pool robot support observer choose pick record films seed out",
)
def run_rearrange(options: Options) -> None:
    """Let a simulated robot arm rearrange the objects of scenes (extra `robot`).

    Example: `cluttergen rearrange --setting blocked --num-episodes 20`
    """
    # Whoever reads the address from a pipe waits for it.
    print(options.call(rearrange, show=partial(print, flush=True)))
