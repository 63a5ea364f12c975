"""A robot arm in simulation: grasps of a pool's objects, and objects picked up and put down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

from cluttergen_jax import SceneSpec
from cluttergen_jax.config import FilmFormat, Method, check_names, check_range, check_workers
from cluttergen_jax.downstream.words import (
    GraspFormat,
    GraspRule,
    PadSource,
    RecordFormat,
    RobotTask,
    check_choice,
    check_factor,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_file, check_folder
from cluttergen_jax.kept_folder import hold_file
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    from cluttergen_jax.downstream.placer.query import Placer, PlainPlacer
    from cluttergen_jax.downstream.robot import (
        GraspDataset,
        GraspSets,
        GraspSource,
        PathPlanner,
        RecordAsked,
        RobotCheck,
        RobotDescription,
        RobotTrials,
        SuctionCup,
    )
    from cluttergen_jax.downstream.robot.grasping.rounds import ClutterProposer, ClutterRounds

_MOST_GRASPS = 4096
_MOST_OBJECT_GRASPS = 100_000
_MOST_SEED = 999_999
_MOST_VIEWS = 64
_MOST_EPISODES = 1_000_000
_NUM_OBJECTS = 8


@with_own_settings
def robot_grasps(
    pool: str | Path = "household",
    objects: Sequence[str] = (),
    *,
    robot: str | Path | RobotDescription = "panda",
    pads: float | PadSource | None = None,
    num_grasps: int = 64,
    seed: int = 0,
    num_threads: int = 0,
    fresh: bool = False,
    out: str | Path | None = None,
    picture: str | Path | None = None,
) -> GraspSets:
    """Finds grasps of a pool's objects for the hand of a robot (`cluttergen robot grasps`).

    Each is tested in MuJoCo: the hand closes, lifts by 15 cm, shakes and turns. What is found is kept for
    each object in the folder `grasps` beside the pools of your own; the same call reads it.

    Args:
      pool: a pool's name or folder, or several joined by +.
      objects: only these of its objects.
      robot: whose hand: a name of `cluttergen list`, or the YAML file of one of your own.
      pads: friction of the fingers' pads, as `robot.set_pads` takes it; the description's if not given.
      num_grasps: for each object at most, spread over it.
      seed: of what is drawn.
      num_threads: 0 takes every core.
      fresh: make again what is kept.
      out: write all of them to this Parquet file too.
      picture: draw each object with some of its grasps, into this PNG file.

    Returns:
      The grasps of each object; printed, a table that names objects with too few.

    Raises:
      ConfigError: a number is out of range, or the robot is none.
      PoolError: there is no such pool or object, or a file of grasps is damaged.
      MissingExtraError: the extra `robot` is not installed.
      RendererError: a picture is wanted, and nothing here can draw.
    """
    from cluttergen_jax.assets import find_pool
    from cluttergen_jax.downstream.robot.check import usable_robot
    from cluttergen_jax.downstream.robot.grasping.grasps import (
        GraspSets,
        grasp_sheet,
        grasps_of,
        write_grasps,
    )
    from cluttergen_jax.downstream.robot.grasping.pads import set_pads

    check_file(out, "out", "grasps.parquet")
    check_file(picture, "picture", "grasps.png")
    check_names(objects, "objects")
    check_workers("num_threads", num_threads)
    check_range("num_grasps", num_grasps, 1, _MOST_GRASPS, 64)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    found = find_pool(pool)
    described = usable_robot(robot)
    if pads is not None:
        described = set_pads(described, pads)
    chosen = tuple(found[name] for name in objects) or found.objects
    with hold_file(out), hold_file(picture):
        made = grasps_of(chosen, num_grasps, seed, num_threads, fresh, described)
        sets = GraspSets(tuple(made))
        if out is not None:
            write_grasps(Path(out), sets.sets)
        if picture is not None:
            from cluttergen_jax.rendering import save_png

            save_png(grasp_sheet(chosen, sets), picture)
        return sets


@with_own_settings
def robot_check(
    robot: str | Path | RobotDescription,
    *,
    picture: str | Path | None = None,
    seed: int = 0,
    num_threads: int = 0,
) -> RobotCheck:
    """Tries the description of a robot (`cluttergen robot check`), in about a CPU-minute.

    Its hand is closed, its arm is asked for 50 poses over its table, and a cube is grasped and lifted in
    simulation. A description in which a name is wrong, whose pads do not meet or close along another axis
    than its tool says, or whose arm reaches nothing is refused at once, here and by all other commands.

    Args:
      robot: a name of `cluttergen list`, or the YAML file of one of your own.
      picture: draw the poses, reached or not, and the cube in the end, into this PNG file.
      seed: of what is drawn.
      num_threads: 0 takes every core.

    Returns:
      Ten numbers; printed, a table, and what to try of each that fails. `is_good` says whether none does.

    Raises:
      ConfigError: the robot is none, or its description is refused.
      MissingExtraError: the extra `robot`, or the package of its models, is not installed.
      RendererError: a picture is wanted, and nothing here can draw.
    """
    import os

    from cluttergen_jax.downstream.robot.check import check_robot_whole
    from cluttergen_jax.downstream.robot.film import check_films

    check_file(picture, "picture", "robot.png")
    check_workers("num_threads", num_threads)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if picture is not None:
        check_films("gif")
    with hold_file(picture):
        found, drawn = check_robot_whole(
            robot, seed, num_threads or os.cpu_count() or 1, picture is not None
        )
        if picture is not None and drawn is not None:
            from cluttergen_jax.rendering import save_png

            save_png(drawn, picture)
        return found


@with_own_settings
def robot_place(
    out: str | Path = "out/robot",
    bank: str | Path | None = None,
    *,
    task: RobotTask = "place",
    robot: str | Path | RobotDescription = "panda",
    placer: str | Path | Placer | PlainPlacer = "drop",
    grasps: GraspSource | GraspSets | None = None,
    planner: PathPlanner | None = None,
    noise: float | None = None,
    num_episodes: int = 40,
    pool: str | Path | None = None,
    method: Method | None = None,
    support: str | Path | None = None,
    num_objects: int | None = None,
    region: str | None = None,
    record: str | Path | None = None,
    record_format: RecordFormat = "lerobot",
    record_cameras: Sequence[str] = ("front", "hand"),
    films: bool = False,
    film: FilmFormat = "gif",
    seed: int = 0,
    num_threads: int = 0,
) -> RobotTrials:
    """Lets a simulated robot arm move the last object of scenes (`cluttergen robot place`).

    In `place` it picks the object from a stand beside the table, puts it down among the others, and leaves;
    in `lift` it lifts it out of them. With `drop`, `guided` or `none` it knows the true state; with any
    other placer it knows of the other objects only what its depth cameras see. The same call resumes an
    interrupted one, and each episode can be repeated from its seed.

    Args:
      out: the folder; rows are kept there.
      bank: the scenes to use; if not given, a bank is generated in the folder. Of scenes in which objects
        lie, `place` takes those whose last object is upright.
      task: place or lift.
      robot: which: a name of `cluttergen list`, or the YAML file of one of your own.
      placer: for `place`: none, the object's own place in the scene; drop, guided or policy, which know the
        whole scene and propose more places if that one cannot be reached; or one that uses depth images:
        geometry, geometry-occupied, random, scored, the folder of a trained one, or in Python one of your own
        (`cluttergen_jax.downstream.placer.query.PlainPlacer`, or `Placer` in JAX).
      grasps: your own, a Parquet file as `robot grasps` writes or with columns object, pose and width; in
        Python also a mapping from objects' names to poses f[G, 7] (T_object_tool) and widths f[G]
        (`cluttergen_jax.downstream.robot.protocols`), or what `robot.grasps` returns. Those that were not
        tested are used as they are, and named. If not given they are made and tested.
      planner: one of your own for the paths between places
        (`cluttergen_jax.downstream.robot.protocols.PathPlanner`).
      noise: factor of the simulated sensor noise of a usual depth camera; 1 if not given, 0 for none.
      num_episodes: number of episodes; scenes repeat if the bank has fewer.
      pool, method, support, num_objects, region: for a generated bank, as in `generate`; household, guided,
        the usual table, 8 and the middle of its region, 0.5x0.5 at most, if not given; for a robot of less
        reach what its description has as `scenes`.
      record: record every episode into this folder: what the arm did is done again in the environment of the
        task and bank, whose observations, actions and success are recorded (`cg.robot.make_env`,
        docs/contract.md; `make_env(recording=...)` makes it again). Episodes of which there are only rows are
        run again for it.
      record_format: "lerobot", a LeRobot dataset of version 3.0 (with cameras extra `video`); or "robomimic",
        HDF5 (extra `record`).
      record_cameras: of the recording, as of `cg.robot.make_env`: overhead, front, side and wrist, which
        stand still, and hand; none if empty.
      films: draw films of the first success and of the first failure of each kind, in the folder films beside
        the rows; those episodes are run again for it.
      film: "gif", or "mp4" (extra video).
      seed: for everything random.
      num_threads: 0 takes every core.

    Returns:
      The episodes; printed, the share of successes, and failures by cause and by object.

    Raises:
      ConfigError: a setting is out of range, or contradicts the bank, or the robot is none; a part of your
        own cannot be told from others, or returned something else than it has to.
      BankError: the bank cannot be read or holds no success, the folder holds episodes of other
        settings, grasps, planners or placers, or an episode that is filmed does not end as it did.
      PoolError: there is no such pool or support.
      MissingExtraError: the extra `robot` is not installed.
      RendererError: pictures are asked for, and nothing here can draw.
    """
    from dataclasses import replace
    from functools import partial

    from cluttergen_jax import generate
    from cluttergen_jax.assets import find_support
    from cluttergen_jax.downstream.bank_scenes import bank_or_made, poses_of
    from cluttergen_jax.downstream.digests import folder_hash, json_digest
    from cluttergen_jax.downstream.placer.scored import placer_folder
    from cluttergen_jax.downstream.robot.check import region_for, usable_robot
    from cluttergen_jax.downstream.robot.film import check_films
    from cluttergen_jax.downstream.robot.places import CameraPlacer, SearchPlaces
    from cluttergen_jax.downstream.robot.trials import keep_upright_last, own_place, run_trials
    from cluttergen_jax.learning import checkpoint_of
    from cluttergen_jax.own_parts import part_label, part_name
    from cluttergen_jax.scene import Bank, read_scenes, region_of

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_range("num_episodes", num_episodes, 1, _MOST_EPISODES, 40)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    check_choice("task", task, RobotTask)
    looking = _looking(placer)
    factor = _factor(noise, task, looking is not None)
    described = usable_robot(robot)
    recorded = cast("RecordAsked | None", record)
    if films:
        check_films(film)

    def make() -> Bank:
        # In a random order the last object is any of the pool, not mostly a small one.
        usual = SceneSpec(pool="household", num_objects=_NUM_OBJECTS, order="random")
        if described.scenes is not None:
            own = described.scenes
            usual = replace(
                usual,
                pool=own.pool,
                support=own.support,
                num_objects=own.num_objects,
                objects=own.objects if pool is None else (),
            )
        bearer = find_support(usual.support if support is None else support)
        usual = replace(usual, region=region_for(described, bearer))
        asked = usual.replace_given(pool, method, support, num_objects, region)
        asked = replace(asked, num_threads=num_threads)
        place = Path(out) / "bank"
        return generate(place, asked, num_scenes=num_episodes, seed=seed, render=False, max_files=0)

    given = (pool, method, support, num_objects, region)
    found = bank_or_made(bank, make, "pool method support num_objects region", given)
    recipe = found.record["recipe"]
    queried = region_of(found)
    scenes = [
        replace(scene, support=replace(scene.support, region=queried))
        for scene in read_scenes(found)
    ]
    if task == "place" and poses_of(found) != "upright":
        scenes = keep_upright_last(scenes)
    # Of another bank's scenes the rows would not be comparable.
    made = json_digest(recipe)
    is_named = isinstance(placer, str | Path)
    told = str(placer) if is_named else part_label(placer, "placer")
    rows = {"task": task, "placer": told, "seed": seed, "pool": recipe.get("pool"), "bank": made}
    places: Any = own_place
    if task == "place" and looking is not None:
        places = CameraPlacer(
            found, looking, str(placer) if is_named else part_name(placer), factor
        )
        trained = placer_folder(placer) if isinstance(placer, str | Path) else None
        rows |= {"noise": factor, "weights": trained and folder_hash(trained)}
    elif task == "place" and placer != "none":
        places = SearchPlaces(found, str(placer), seed, num_threads)
        policy = checkpoint_of(str(placer), str(recipe.get("pool")))
        rows |= {"weights": policy and policy.hash}
    return run_trials(
        scenes,
        task,
        num_episodes,
        seed,
        Path(out) / task,
        rows,
        num_threads=num_threads,
        places=places,
        films=film if films else None,
        robot=described,
        own_grasps=grasps,
        planner=planner,
        record=None
        if recorded is None
        else partial(
            recorded.open, "grasp" if task == "lift" else "place", str(found.path), described
        ),
    )


def _looking(placer: str | Path | Placer | PlainPlacer) -> Placer | PlainPlacer | None:
    """The placer that looks, None of what knows the true state.

    Raises:
      ConfigError: there is none of that name, or it cannot be called.
      PoolError: the folder holds no placer, or a damaged one.
    """
    from cluttergen_jax.downstream.placer.proposers import FullState, find_placer

    if isinstance(placer, str) and placer == "none":
        return None
    found = find_placer(placer)
    return None if isinstance(found, FullState) else found


def _factor(noise: float | None, task: str, is_looking: bool) -> float:
    """So many times the usual noise.

    Raises:
      ConfigError: it is out of range, or nothing looks.
    """
    if noise is None:
        return 1.0
    if task != "place":
        raise ConfigError(
            f"noise = {noise!r} with task = {task!r}",
            "place, and a placer that looks",
            "task='place'",
        )
    if not is_looking:
        raise ConfigError(
            f"noise = {noise!r} where nothing looks", "a placer that looks", "placer='scored'"
        )
    check_factor(noise)
    return float(noise)


@with_own_settings
def grasp_dataset(
    bank: str | Path,
    out: str | Path = "grasp-dataset",
    *,
    format: Sequence[GraspFormat] = ("vgn", "giga"),
    robot: str | Path | RobotDescription | SuctionCup = "panda",
    num_object_grasps: int = 2000,
    num_grasps: int = 120,
    num_lifts: int | None = None,
    views: int = 6,
    noise: float = 1.0,
    num_scenes: int | None = None,
    seed: int = 0,
    num_threads: int = 0,
) -> GraspDataset:
    """Makes a dataset of labelled grasps in the scenes of a bank (`cluttergen robot dataset`).

    Of each scene that stands, depth images with noise, a volume of truncated signed distances, and candidates
    for the hand of a robot: whether each is free in the clutter, and whether it lifts an object, in
    MuJoCo with everything awake. Failures are kept. Written as Parquet with a card, and as files that other
    projects' training code opens. The same call takes up an interrupted one.

    Args:
      bank: the bank's folder: tables, shelves, bins, piles.
      out: the folder.
      format: of which projects files are written, one or more: "vgn", "giga" (scenes as volumes); "acronym"
        (objects by themselves, HDF5: extra `record`), "contact_graspnet" (with ACRONYM's files: contacts in
        scenes, pictures), "graspnet" (GraspNet-1Billion's layout; of a suction cup SuctionNet-1Billion's).
      robot: whose hand: a name of `cluttergen list`, or the YAML file of one of your own; or a suction cup:
        "suction", a YAML file, or a `SuctionCup`.
      num_object_grasps: candidates of each object by itself, for the last three formats, half of them free
        where so many are found; GraspNet's labels have a point of the object for every 100.
      num_grasps: candidates kept of each scene, half of them free where so many are found.
      num_lifts: so many of a scene's free ones are executed; all if not given, 0 for none.
      views: pictures of each scene.
      noise: factor of the simulated sensor noise of a usual depth camera; 0 for none.
      num_scenes: the first so many; all if not given.
      seed: of candidates, cameras and noise.
      num_threads: 0 takes every core.

    Returns:
      The dataset; printed, it tells what there is.

    Raises:
      ConfigError: a number is out of range, a format is unknown or not for this hand, the robot is none, or
        its hand can hold none of the bank's objects.
      BankError: there is no bank, none of its scenes stands, or the folder holds something else.
      MissingExtraError: the extra `robot` is not installed, or `record` for "acronym".
      RendererError: a format has pictures, and nothing here can draw.
    """
    import os

    from cluttergen_jax.downstream.robot.grasping.grasp_dataset import GraspPlan, make
    from cluttergen_jax.downstream.robot.grasping.suction import find_hand
    from cluttergen_jax.scene import bank_folder

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_names(format, "format")
    for each in format:
        check_choice("format", each, GraspFormat)
    if not format:
        raise ConfigError("format = ()", f"one or more of {', '.join(get_args(GraspFormat))}")
    check_range("num_object_grasps", num_object_grasps, 1, _MOST_OBJECT_GRASPS, 2000)
    check_range("num_grasps", num_grasps, 1, _MOST_GRASPS, 120)
    check_range("views", views, 1, _MOST_VIEWS, 6)
    check_factor(noise)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if num_lifts is not None:
        check_range("num_lifts", num_lifts, 0, _MOST_GRASPS, 20)
    if num_scenes is not None:
        check_range("num_scenes", num_scenes, 1, _MOST_EPISODES, 100)
    lifts = num_grasps if num_lifts is None else num_lifts
    # In an order of its own, so that the same formats are the same dataset.
    formats = tuple(each for each in get_args(GraspFormat) if each in format)
    hand = find_hand(robot)
    plan = GraspPlan(hand, formats, num_object_grasps, num_grasps, lifts, views, float(noise), seed)
    return make(bank_folder(bank), num_scenes, plan, Path(out), num_threads or os.cpu_count() or 1)


@with_own_settings
def clear_clutter(
    bank: str | Path,
    proposer: str | ClutterProposer = "geometry",
    *,
    rule: GraspRule = "vgn",
    robot: str | Path | RobotDescription = "panda",
    pads: float | PadSource | None = None,
    views: int = 6,
    noise: float = 1.0,
    num_rounds: int | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    num_threads: int = 0,
) -> ClutterRounds:
    """Clears the piles of a bank grasp by grasp, in rounds as in VGN's paper (`cluttergen robot clear`).

    Before each attempt the hand's cameras look anew, a proposer chooses one grasp, and MuJoCo executes it
    with everything awake; what is lifted is taken away, and the rest settles. A round ends when no object is
    left, nothing is proposed, or two attempts in a row fail (Breyer et al., CoRL 2020).

    Args:
      bank: the bank's folder: piles on 0.28x0.28 m; what lies outside of VGN's cube of 30 cm is left out.
      proposer: "geometry", antipodal grasps of the seen volume whose open hand is clear; or your own, as
        FILE.py:NAME or MODULE:NAME; in Python also a function (rng, view) -> T_world_tool f[4, 4] and a width
        in metres, or None (`cluttergen_jax.downstream.robot.grasping.rounds.ClutterProposer`).
      rule: "vgn": the hand starts wide open, 5 cm back, stops where it touches something and closes there,
        goes back by 10 cm, and counts if it holds something then. "strict": the hand, opened for what it
        takes, may touch nothing at the grasp and on its last 10 cm, and lifts the object by 8 cm or more.
      robot: whose hand: a name of `cluttergen list`, or the YAML file of one of your own.
      pads: friction of the fingers' pads, as `robot.set_pads` takes it; the description's if not given.
      views: depth images before each attempt.
      noise: factor of the simulated sensor noise of a usual depth camera; 0 for none.
      num_rounds: the first so many scenes; all if not given.
      out: write the rounds into this JSON file too.
      seed: of cameras, noise and choices.
      num_threads: 0 takes every core.

    Returns:
      The rounds; printed, the success rate of attempts and the share of objects cleared.

    Raises:
      ConfigError: a setting is out of range, or a proposer of your own answers something else.
      BankError: there is no bank, none of its scenes stands, or the hand can hold none of its objects.
      MissingExtraError: the extra `robot` is not installed.
    """
    import os

    from cluttergen_jax.downstream.robot.check import usable_robot
    from cluttergen_jax.downstream.robot.grasping.pads import set_pads
    from cluttergen_jax.downstream.robot.grasping.rounds import (
        RoundPlan,
        clear_piles,
        find_proposer,
    )
    from cluttergen_jax.scene import bank_folder

    check_file(out, "out", "rounds.json")
    check_choice("rule", rule, GraspRule)
    check_workers("num_threads", num_threads)
    check_range("views", views, 1, _MOST_VIEWS, 6)
    check_factor(noise)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if num_rounds is not None:
        check_range("num_rounds", num_rounds, 1, _MOST_EPISODES, 40)
    described = usable_robot(robot)
    if pads is not None:
        described = set_pads(described, pads)
    plan = RoundPlan(described, rule, find_proposer(proposer), views, float(noise), seed)
    target = None if out is None else Path(out)
    with hold_file(out):
        threads = num_threads or os.cpu_count() or 1
        return clear_piles(bank_folder(bank), plan, num_rounds, threads, target)
