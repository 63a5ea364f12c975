"""Rearrangement: a simulated arm brings objects into one of several new layouts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

from cluttergen_jax.config import FilmFormat, check_range, check_workers
from cluttergen_jax.downstream.words import (
    LayoutRule,
    PickOrder,
    Rearrangement,
    RecordFormat,
    RobotObserver,
    check_choice,
    check_factor,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    from cluttergen_jax.assets import ObjectAsset, Rectangle
    from cluttergen_jax.downstream.rearrange.layout_views import LayoutPanel
    from cluttergen_jax.downstream.rearrange.observe import Observer
    from cluttergen_jax.downstream.rearrange.perceive import PerceptionObserver
    from cluttergen_jax.downstream.rearrange.starts import OwnScenes
    from cluttergen_jax.downstream.rearrange.trials import Rearrangements
    from cluttergen_jax.downstream.robot import (
        GraspSets,
        GraspSource,
        PathPlanner,
        RecordAsked,
        RobotDescription,
    )

_MOST_SEED = 999_999
_MOST_EPISODES = 1_000_000
_MOST_LAYOUTS = 64


@with_own_settings
def rearrange(
    out: str | Path = "out/rearrange",
    bank: str | Path | None = None,
    *,
    setting: Rearrangement = "paper",
    num_episodes: int = 20,
    robot: str | Path | RobotDescription = "panda",
    pool: str | Path | None = None,
    support: str | Path | None = None,
    target: str | Rectangle | None = None,
    goals: str | Path = "",
    choose: LayoutRule = "clearance",
    num_layouts: int = 10,
    layout: int | None = None,
    relook: bool = True,
    order: PickOrder = "graph",
    one_grasp: bool = False,
    observer: RobotObserver | Observer = "true",
    grasps: GraspSource | GraspSets | None = None,
    planner: PathPlanner | None = None,
    segmenter: str | Path | None = None,
    noise: float | None = None,
    cameras: Sequence[str | Path] = (),
    pick: bool = False,
    show_layouts: bool = False,
    record: str | Path | None = None,
    record_format: RecordFormat = "lerobot",
    record_cameras: Sequence[str] = ("front", "hand"),
    films: bool = False,
    film: FilmFormat = "gif",
    seed: int = 0,
    num_threads: int = 0,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    show: Callable[[str], None] = print,
) -> Rearrangements:
    """Lets a simulated robot arm rearrange the objects of scenes (`cluttergen rearrange`).

    The generator draws 128 layouts or more; the most different ones with enough room are kept, and one is
    chosen. The arm moves one object after another, by way of free places if they are in each other's way,
    and looks again after each. An observer tells it where objects are. The same call resumes an interrupted
    one, and each episode can be repeated from its seed.

    Args:
      out: the folder; rows are kept there, for each setting apart.
      setting: paper (five objects into an empty half of the table), occupied (three others are there),
        blocked (into the very area where they are), eight (objects), or stacked (one lies on another at
        first).
      bank: the starting scenes, taken in turn; all of their objects are moved, to layouts in the whole of the
        bank's region that the arm reaches. Its rows, and those of other `support`, `target` and `goals`, are
        kept in OUT/own.
      num_episodes: number of episodes.
      robot: which: a name of `cluttergen list`, or the YAML file of one of your own; segmenters
        learned with pictures of the Panda alone.
      pool: a pool's name or folder, or several joined by +; household if not given.
      support: a support's name or folder, to whose middle the setting is moved; the usual table if not given.
      target: where layouts are drawn, X,Y,W,D[,YAW] in metres and degrees, or WxD about the region's middle;
        in Python also a `Rectangle`.
      goals: a bank's folder or FOLDER:INDEX, whose layouts are the targets of the objects that they have; or
        relations, "put the candle left of the basket; toy_car behind candle", which move what each is said
        of. All else stays.
      choose: the rule by which a layout is chosen: clearance, with the widest gap between objects; reach,
        with the most objects that the hand can get at; or similar, with the shortest ways.
      num_layouts: number of different layouts to choose from.
      layout: use this one of them, by number, instead of the rule.
      relook: look again after each move, and try again what went wrong; without it only once.
      order: graph, by what is in whose way; or lowest object first, as in the paper.
      one_grasp: an object has a single grasp, at 0 and 180 degrees, as in the paper.
      observer: true, the true poses; or perception, what cameras over the table and on the hand show, with
        noise (extra `perception`); in Python also one of your own
        (`cluttergen_jax.downstream.rearrange.observe.Observer`), whose attribute `name` is in the table.
      grasps, planner: your own, as of `robot.place`.
      segmenter: for `perception`: a folder of `python -m studies.perception train`, or a pool's name
        where one comes with the package; the pool's own if not given.
      noise: for `perception`: factor of the simulated sensor noise; 1 if not given, 0 for none.
      cameras: for `perception`: "wrist", and those that look when the arm has drawn back, by name or in JSON
        files as of `render`; if not given the wrist's and one over the table.
      pick: in each episode a person looks at the layouts in a browser, in the order of the rule, and takes
        one (extra `viewer`); it is the only one that is tried.
      show_layouts: draw each episode's layouts over the scene as it is, on a sheet layouts-NUMBER.png
        beside the rows, the chosen one framed.
      record, record_format, record_cameras: as of `robot.place`.
      films: draw films of the first success and of the first failure of each kind, in the folder films beside
        the rows; those episodes are run again for it.
      film: "gif", or "mp4" (extra video).
      seed: for everything random.
      num_threads: 0 takes every core.
      host: with `pick`, the address to listen on; 0.0.0.0 lets other machines in, if they have the token.
      port: the port to listen on; 0 takes any free one.
      browser: open a browser.
      show: is given the line with the address.

    Returns:
      The episodes; printed, the share of successes, failures by cause, and what an episode costs.

    Raises:
      ConfigError: a setting is unknown or out of range, the pool has too few objects, goals are not
        understood, a target is out of reach, or the port is taken.
      BankError: the folder holds other episodes or a damaged file, or an episode that is filmed does not end
        as it did.
      PoolError: there is no such pool or segmenter.
      MissingExtraError: the extra `robot`, or `perception` or `viewer` where it is needed, is not installed.
      RendererError: pictures are asked for, and nothing here can draw.
    """
    from dataclasses import replace
    from typing import Any

    from cluttergen_jax.downstream.rearrange.task import SETTINGS, RearrangeOptions
    from cluttergen_jax.downstream.rearrange.trials import run_rearrangements
    from cluttergen_jax.downstream.robot import check_films, usable_robot

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_range("num_episodes", num_episodes, 1, _MOST_EPISODES, 20)
    check_range("num_layouts", num_layouts, 1, _MOST_LAYOUTS, 10)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if layout is not None:
        check_range("layout", layout, 0, num_layouts - 1, 0)
    check_choice("setting", setting, Rearrangement)
    check_choice("choose", choose, LayoutRule)
    check_choice("order", order, PickOrder)
    if not callable(observer):
        check_choice("observer", observer, RobotObserver)
    if pick and layout is not None:
        raise ConfigError(
            f"`pick` together with layout = {layout}", "one or the other", "leaving out `layout`"
        )
    looks = observer == "perception"
    for what, given in (("segmenter", segmenter), ("noise", noise), ("cameras", cameras or None)):
        if given is not None and not looks:
            raise ConfigError(
                f"`{what}` where nothing looks", "observer='perception'", "leaving it out"
            )
    if noise is not None:
        check_factor(noise)
    described = usable_robot(robot)
    found, told, usual = _own_scenes(bank, pool, support, target, str(goals), setting)
    recorded = cast("RecordAsked | None", record)
    if films or show_layouts:
        check_films(film)
    looking: Any = observer
    if looks:
        looking = _looking(
            usual, found, segmenter, seed, 1.0 if noise is None else noise, cameras, described
        )
    options = RearrangeOptions(choose, layout, num_layouts, relook, order, one_grasp)
    name = "own" if told else setting
    with _person(choose, host, port, browser, show) if pick else nullcontext() as person:
        return run_rearrangements(
            replace(SETTINGS[setting], name=name),
            options,
            num_episodes,
            seed,
            Path(out) / name,
            pool=usual,
            observer=None if isinstance(looking, str) else looking,
            num_threads=num_threads,
            ask=person,
            films=film if films else None,
            sheets=show_layouts,
            robot=described,
            own_grasps=grasps,
            planner=planner,
            own=found,
            told_own=told,
            record=recorded,
        )


@contextmanager
def _person(
    rule: LayoutRule, host: str, port: int, browser: bool, show: Callable[[str], None]
) -> Iterator[LayoutPanel]:
    """A panel in a browser in which layouts are chosen."""
    from cluttergen_jax.downstream.rearrange.layout_views import LayoutPanel
    from cluttergen_jax.rendering import announce, open_server

    server = open_server(host, port, "cluttergen: which layout")
    try:
        panel = LayoutPanel(server, rule)
        announce(server, browser, show)
        try:
            yield panel
        finally:
            panel.close()
    finally:
        server.stop()


def _own_scenes(
    bank: str | Path | None,
    pool: str | Path | None,
    support: str | Path | None,
    target: str | Rectangle | None,
    goals: str,
    setting: str,
) -> tuple[OwnScenes, dict[str, object], str]:
    """What of the setting is the user's own, what a recipe says of that if anything, and the pool."""
    from cluttergen_jax.assets import find_support, parse_region, support_hash
    from cluttergen_jax.downstream.bank_scenes import check_one_level
    from cluttergen_jax.downstream.digests import json_digest
    from cluttergen_jax.downstream.rearrange.starts import OwnScenes, bank_place, is_bank
    from cluttergen_jax.scene import read_bank, region_of

    found = None if bank is None else read_bank(bank)
    for what, value in (("pool", pool), ("support", support)):
        if found is not None and value is not None:
            raise ConfigError(
                f"`{what}` together with `bank`", "one or the other", f"leaving out `{what}`"
            )
    if found is not None and setting != "paper":
        given = f"setting = {setting!r} together with `bank`, whose scenes take its place"
        raise ConfigError(given, "one or the other", "leaving out `setting`")
    check_one_level(
        find_support(support or "table") if found is None else found.support, "`rearrange`"
    )
    pool = "household" if pool is None else str(pool)
    if found is not None:
        pool = str(found.record["recipe"].get("pool"))
    if isinstance(target, str):
        middle = find_support(support or "table").region if found is None else region_of(found)
        target = parse_region(target, middle)
    own = OwnScenes(found, None if support is None else str(support), target, goals)
    told: dict[str, object] = {}
    if found is not None:
        told["bank"] = json_digest(found.record["recipe"])
    if support is not None:
        told["support"] = f"{support} {support_hash(find_support(support))[:16]}"
    if target is not None:
        told["target"] = [*target.center, *target.half_extents, target.yaw]
    if goals:
        told["goals"] = goals
    if goals and is_bank(goals):
        told["layouts"] = json_digest(read_bank(bank_place(goals)[0]).record["recipe"])
    return own, told and told | {"based_on": setting if found is None else "bank"}, pool


def _looking(
    pool: str,
    own: OwnScenes,
    segmenter: str | Path | None,
    seed: int,
    noise: float,
    cameras: Sequence[str | Path],
    robot: RobotDescription,
) -> PerceptionObserver:
    """The observer that looks through cameras, for a pool's objects on a support, or for a bank's."""
    from dataclasses import replace

    from cluttergen_jax.assets import find_pool, find_support
    from cluttergen_jax.downstream.digests import folder_hash
    from cluttergen_jax.downstream.noise import NOISE_OFF, REALSENSE
    from cluttergen_jax.downstream.perception.finder import load_finder
    from cluttergen_jax.downstream.perception.segmenter import segmenter_folder
    from cluttergen_jax.downstream.rearrange.perceive import PerceptionObserver
    from cluttergen_jax.rendering import find_backend
    from cluttergen_jax.scene import region_of
    from cluttergen_jax.sensing import parse_cameras

    support = find_support(own.support or "table")
    wanted = pool if segmenter is None else segmenter
    objects: Sequence[ObjectAsset] = find_pool(pool).objects if own.bank is None else ()
    if own.bank is not None:
        support = replace(own.bank.support, region=region_of(own.bank))
        objects = [own.bank.object(name) for name in own.bank.assets["objects"]]
    finder = load_finder(wanted, objects, support)
    find_backend()
    others = [each for each in cameras if str(each) != "wrist"]
    return PerceptionObserver(
        finder,
        support,
        REALSENSE.scale(noise) if noise else NOISE_OFF,
        seed,
        folder_hash(segmenter_folder(wanted)),
        parse_cameras(others) if others else (),
        not cameras or len(others) < len(cameras),
        robot,
    )
