"""Rearrangement: a simulated arm brings objects into one of several new layouts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.config import (
    FilmFormat,
    LayoutRule,
    PickOrder,
    Rearrangement,
    RobotObserver,
    check_range,
    check_workers,
)
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.files import check_folder
from cluttergen_jax.numerics import with_own_settings

if TYPE_CHECKING:
    from cluttergen_jax.downstream.rearrange.observe import Observer
    from cluttergen_jax.downstream.rearrange.perceive import PerceptionObserver
    from cluttergen_jax.downstream.rearrange.pick import LayoutPanel
    from cluttergen_jax.downstream.rearrange.trials import Rearrangements
    from cluttergen_jax.downstream.robot.grasping.grasps import GraspSets
    from cluttergen_jax.downstream.robot.protocols import GraspSource, PathPlanner

_MOST_SEED = 999_999
_MOST_EPISODES = 1_000_000
_MOST_LAYOUTS = 64


@with_own_settings
def rearrange(
    out: str | Path = "out/rearrange",
    *,
    setting: Rearrangement = "paper",
    num_episodes: int = 20,
    pool: str | Path = "household",
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
    pick: bool = False,
    show_layouts: bool = False,
    films: bool = False,
    film: FilmFormat = "gif",
    seed: int = 0,
    num_threads: int = 0,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    show: Callable[[str], None] = print,
) -> Rearrangements:
    """Lets a simulated Franka Panda rearrange the objects of scenes (`cluttergen rearrange`).

    The generator draws 128 layouts or more; the most different ones with enough room are kept, and one is
    chosen. The arm moves one object after another, by way of free places if they are in each other's way,
    and looks again after each. An observer tells it where objects are. The same call resumes an interrupted
    one, and each episode can be repeated from its seed.

    Args:
      out: the folder; rows are kept there, for each setting apart.
      setting: paper (five objects into an empty half of the table), occupied (three others are there),
        blocked (into the very area where they are), eight (objects), or stacked (one lies on another at
        first).
      num_episodes: number of episodes.
      pool: a pool's name or folder, or several joined by +.
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
      grasps, planner: your own, as of `robot_place`.
      segmenter: for `perception`: a folder of `perception train`, or a pool's name where one comes with the
        package; the pool's own if not given.
      pick: in each episode a person looks at the layouts in a browser, in the order of the rule, and takes
        one (extra `viewer`); it is the only one that is tried.
      show_layouts: draw each episode's layouts over the scene as it is, on a sheet layouts-NUMBER.png
        beside the rows, the chosen one framed.
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
      ConfigError: a setting is unknown or out of range, the pool has too few objects, or the port is taken.
      BankError: the folder holds other episodes or a damaged file, or an episode that is filmed does not end
        as it did.
      PoolError: there is no such pool or segmenter.
      MissingExtraError: the extra `robot`, or `perception` or `viewer` where it is needed, is not installed.
      RendererError: pictures are asked for, and nothing here can draw.
    """
    import os
    from typing import get_args

    from cluttergen_jax.downstream.rearrange.task import SETTINGS, RearrangeOptions
    from cluttergen_jax.downstream.rearrange.trials import run_rearrangements
    from cluttergen_jax.downstream.robot.film import check_films
    from cluttergen_jax.downstream.robot.model import panda_folder

    check_folder(out)
    check_workers("num_threads", num_threads)
    check_range("num_episodes", num_episodes, 1, _MOST_EPISODES, 20)
    check_range("num_layouts", num_layouts, 1, _MOST_LAYOUTS, 10)
    check_range("seed", seed, 0, _MOST_SEED, 0)
    if layout is not None:
        check_range("layout", layout, 0, num_layouts - 1, 0)
    asked = (
        ("setting", setting, Rearrangement),
        ("choose", choose, LayoutRule),
        ("order", order, PickOrder),
        ("observer", observer if isinstance(observer, str) else "true", RobotObserver),
    )
    for name, value, known in asked:
        if value not in get_args(known):
            raise ConfigError(f"{name} = {value!r}", ", ".join(get_args(known)))
    if segmenter is not None and observer != "perception":
        raise ConfigError(
            f"`segmenter` with observer = {observer!r}", "observer='perception'", "leaving it out"
        )
    if not (isinstance(observer, str) or callable(observer)):
        raise ConfigError(
            f"observer = {observer!r}", f"{', '.join(get_args(RobotObserver))}, or an `Observer`"
        )
    if pick and layout is not None:
        raise ConfigError(
            f"`pick` together with layout = {layout}", "one or the other", "leaving out `layout`"
        )
    panda_folder()
    if films or show_layouts:
        check_films(film)
    looking = _looking(pool, segmenter, seed) if observer == "perception" else observer
    options = RearrangeOptions(choose, layout, num_layouts, relook, order, one_grasp)
    threads = num_threads or os.cpu_count() or 1
    with _person(choose, host, port, browser, show) if pick else nullcontext() as person:
        return run_rearrangements(
            SETTINGS[setting],
            options,
            num_episodes,
            seed,
            Path(out) / setting,
            pool=str(pool),
            observer=None if isinstance(looking, str) else looking,
            num_threads=threads,
            ask=person,
            films=film if films else None,
            sheets=show_layouts,
            own_grasps=grasps,
            planner=planner,
        )


@contextmanager
def _person(
    rule: LayoutRule, host: str, port: int, browser: bool, show: Callable[[str], None]
) -> Iterator[LayoutPanel]:
    """A panel in a browser in which layouts are chosen."""
    from cluttergen_jax.downstream.rearrange.pick import LayoutPanel
    from cluttergen_jax.rendering.viewer.viewer import announce, open_server

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


def _looking(pool: str | Path, segmenter: str | Path | None, seed: int) -> PerceptionObserver:
    """The observer that looks through cameras, for a pool's objects on the usual table."""
    from cluttergen_jax.assets.pool import find_pool
    from cluttergen_jax.assets.support_file import find_support
    from cluttergen_jax.downstream.perception.finder import load_finder
    from cluttergen_jax.downstream.perception.segment.network_segmenter import segmenter_folder
    from cluttergen_jax.downstream.rearrange.perceive import PerceptionObserver
    from cluttergen_jax.learning.ppo import checkpoint
    from cluttergen_jax.rendering.gl import find_backend

    support, wanted = find_support("table"), pool if segmenter is None else segmenter
    finder = load_finder(wanted, find_pool(pool).objects, support)
    find_backend()
    return PerceptionObserver(
        finder, support, seed=seed, weights=checkpoint.folder_hash(segmenter_folder(wanted))
    )
