"""A robot arm in simulation: grasps of a pool's objects, and objects picked up and put down."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from cluttergen_jax import SceneSpec
from cluttergen_jax.config import FilmFormat, Method, check_names, check_range, check_workers
from cluttergen_jax.downstream.words import (
    GraspFormat,
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
    from cluttergen_jax.assets import Rectangle
    from cluttergen_jax.downstream.placer.query import Placer, PlainPlacer
    from cluttergen_jax.downstream.robot import (
        GraspDataset,
        GraspSets,
        GraspSource,
        PathPlanner,
        RobotDescription,
        RobotTrials,
        SuctionCup,
    )

_MOST_GRASPS = 4096
_MOST_OBJECT_GRASPS = 100_000
_MOST_SEED = 999_999
_MOST_VIEWS = 64
_MOST_EPISODES = 1_000_000
_REGION = 0.5
_NUM_OBJECTS = 8


@with_own_settings
def robot_grasps(
    pool: str | Path = "household",
    objects: Sequence[str] = (),
    *,
    robot: str | Path | RobotDescription = "panda",
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
    from cluttergen_jax.downstream.robot.description import find_robot
    from cluttergen_jax.downstream.robot.grasping.grasps import (
        GraspSets,
        grasp_sheet,
        grasps_of,
        write_grasps,
    )

    check_file(out, "out", "grasps.parquet")
    check_file(picture, "picture", "grasps.png")
    check_names(objects, "objects")
    check_workers("num_threads", num_threads)
    check_range("num_grasps", num_grasps, 1, _MOST_GRASPS, 64)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    found = find_pool(pool)
    described = find_robot(robot)
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
    record_cameras: Sequence[str | Path] = ("third", "wrist"),
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
        the usual table, 8 and the middle of its region, 0.5x0.5 at most, if not given.
      record: record every episode into this folder, 20 frames a second: joints, tool, gripper, contact,
        set-points, success, the task in words, and pictures. Episodes of which there are only rows are run
        again for it.
      record_format: "lerobot", a LeRobot dataset of version 3.0 (with cameras extra `video`); or "robomimic",
        HDF5 (extra `record`).
      record_cameras: of the recording: "third" (across the table), "wrist", and others by name or in JSON
        files as of `render`; none if empty.
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
    from typing import Any

    from cluttergen_jax import generate
    from cluttergen_jax.downstream.bank_scenes import bank_or_made, poses_of
    from cluttergen_jax.downstream.digests import folder_hash, json_digest
    from cluttergen_jax.downstream.placer.scored import placer_folder
    from cluttergen_jax.downstream.robot.description import find_robot
    from cluttergen_jax.downstream.robot.film import check_films
    from cluttergen_jax.downstream.robot.places import CameraPlacer, SearchPlaces
    from cluttergen_jax.downstream.robot.recorder import RecordAsked
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
    described = find_robot(robot)
    recorded = RecordAsked.of(record, record_format, record_cameras)
    if films:
        check_films(film)

    def make() -> Bank:
        # In a random order the last object is any of the pool, not mostly a small one.
        usual = SceneSpec(pool="household", num_objects=_NUM_OBJECTS, order="random")
        usual = replace(usual, region=_usual_region(usual.support if support is None else support))
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
        record=recorded,
    )


def _usual_region(support: str | Path) -> Rectangle:
    """The middle of a support's region, which the arm reaches: half a metre a side at most."""
    from dataclasses import replace

    from cluttergen_jax.assets import find_support

    region = find_support(support).region
    half_x, half_y = region.half_extents
    return replace(region, half_extents=(min(half_x, _REGION / 2), min(half_y, _REGION / 2)))


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
