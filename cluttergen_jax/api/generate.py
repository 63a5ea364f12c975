"""Banks of scenes: sampled from names and numbers, repaired, and made by hand in a browser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from cluttergen_jax.api.text import scene_numbers
from cluttergen_jax.config import check_range
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.kept_folder import hold_file
from cluttergen_jax.numerics import with_kept_programs
from cluttergen_jax.placement.methods.table import TARGETS
from cluttergen_jax.spec import SceneOptions, SceneSpec, in_groups, spec_of, takes_spec

if TYPE_CHECKING:
    from cluttergen_jax.generation.generate import GeneratedBank
    from cluttergen_jax.generation.repair import RepairReport

MAX_SCENES = 2_000_000_000
_MOST = 2**32 - 1
_PERSON = "where a person places"
_NOT_BY_HAND = {
    **dict.fromkeys(
        ("method", "checkpoint", "height", "poses", *TARGETS, "clearance", "crowd", "doors"),
        _PERSON,
    ),
    **dict.fromkeys(
        ("order", "sets", "max_attempts", "ruin_after", "budget"), f"{_PERSON}, as often as wanted"
    ),
    **dict.fromkeys(
        ("shelf", "weights", "balance", "surface", "start"), "where one world is opened"
    ),
    **dict.fromkeys(
        ("robust", "for_engine", "setting", "stability"), "where the usual check is made"
    ),
    **dict.fromkeys(
        ("engine", "num_threads"), "where the native engine judges one attempt at a time"
    ),
}
"""Fields of a `SceneSpec` that placing by hand does not take, and why."""


@with_kept_programs
@takes_spec()
@in_groups(
    what="layout",
    how_many="num_scenes seed",
    files="out render max_files overwrite allow_other_bits",
    machine="cluster workers",
)
def generate(
    out: str | Path = "out",
    spec: SceneSpec | str | Path | None = None,
    *,
    layout: str | Path | None = None,
    num_scenes: int = 20,
    seed: int = 0,
    render: bool = True,
    max_files: int = 1000,
    overwrite: bool = False,
    allow_other_bits: bool = False,
    cluster: str | None = None,
    workers: int = 0,
    **options: Unpack[SceneOptions],
) -> GeneratedBank:
    """Samples scenes and saves them as a bank, failures included; `cluttergen generate`.

    The same call continues an interrupted one, and mends what is damaged. Scene i of it is what
    `make_sampler` makes of the key `jax.random.fold_in(jax.random.key(seed), i)`, but for `sets`. The
    arguments that are not explained here are those of `SceneSpec`.

    Args:
      out: the bank's folder, or a URL such as s3://bucket/name; an interrupted bank is continued.
      spec: what is asked for, or a pool's name.
      layout: what shall stand where: a YAML file, or a name of `cluttergen list`, such as breakfast_for_two
        (`layout.read`); other options that are not at their defaults go before what it says.
      num_scenes: scenes to make, failures counted; with `sets` a multiple of them.
      seed: the same seed makes the same scenes, 0 to 4294967295.
      render: draw a picture of each scene that gets a file.
      max_files: the first so many scenes get an MJCF file each (and a picture) if they succeed.
      overwrite: begin anew if the folder holds another bank.
      allow_other_bits: continue a bank even if another processor, other flags of XLA or another jaxlib made
        its scenes, so that the same seed here makes others; its record tells of both.
      cluster: where scenes are made: "local", Ray on this machine; "auto", the Ray cluster that this machine
        belongs to; or a cluster's address (extra `ray`). In this process if not given.
      workers: worker processes on the cluster, of `num_threads` cores each, one if that is 0; 0 takes as many
        as it has room for. Equal machines make the same bank, however many there are.
      options: fields of `SceneSpec`, in place of those of `spec`.

    Returns:
      The bank; printed, it tells how well it went.

    Raises:
      ConfigError, PoolError: as `make_sampler`.
      BankError: the folder holds something else, cannot be written, or is being written by another process;
        or the scene to start from cannot be read.
      MissingExtraError: a cluster without the extra `ray`.
    """
    from cluttergen_jax.cluster import cluster_of
    from cluttergen_jax.generation.generate import write_bank
    from cluttergen_jax.generation.layouts import asked_of, read_layout

    asked_in_words = None
    if layout is not None:
        if spec is not None:
            raise ConfigError(f"`layout` {str(layout)!r} beside `spec`", "one or the other")
        spec = read_layout(layout, options.get("pool"))
        asked_in_words = asked_of(layout)
    asked = spec_of(generate, spec, options)
    check_range("num_scenes", num_scenes, 1, MAX_SCENES, 20)
    check_range("seed", seed, 0, _MOST, 0)
    asked.check_num_scenes(num_scenes)
    if max_files < 0:
        raise ConfigError(f"max_files = {max_files}", "0 or more", "max_files=0 for none")
    return write_bank(
        out,
        asked,
        seed,
        num_scenes,
        render,
        max_files,
        overwrite,
        cluster_of(cluster, workers),
        allow_other_bits,
        asked_in_words,
    )


@with_kept_programs
def repair(
    source: str | Path,
    out: str | Path = "out/repaired",
    *,
    pool: str | None = None,
    support: str | None = None,
    scenes: Sequence[int] | str | None = None,
    max_shift: float = 0.05,
    max_turn_deg: float = 45.0,
    overwrite: bool = False,
) -> RepairReport:
    """Makes a broken layout stable with little motion: noisy poses, those of a language model, old starts.

    What is stable is left as it is. Of anything else each object, from the lowest up, is lifted or lowered to
    first contact and let go, or moved to the nearest place where it is stable; what lies on what is kept. The
    result passes the final check of `generate`. What cannot be repaired is named, and nothing is left out.

    Args:
      source: a bank or a scene of it (BANK:INDEX), failed scenes included; a JSON file; or a folder of JSON
        files. Such a file has pool, support, unit (m if not given, cm, mm), and objects, each with a name,
        the pool's name for it as asset if that is another, position (z up, from the floor below the
        support's centre) and one of quaternion_wxyz, quaternion_xyzw, rpy_deg, rpy (radians), yaw_deg,
        yaw (radians), and euler with euler_unit (deg, rad) and euler_order (xyz: fixed axes; XYZ: axes that
        turn along); scenes of `cluttergen export` are such files. Other keys are refused.
      out: a bank, or for a single layout also a JSON file.
      pool: of JSON files that name none, or in place of what they name.
      support: likewise.
      scenes: of a bank, numbers such as 0,3,7 or 0-9; all if not given. In Python also a list.
      max_shift: metres by which an object may be moved, 0.5 at most.
      max_turn_deg: degrees by which it may be turned.
      overwrite: begin anew if the folder holds another bank; replace a JSON file.

    Returns:
      What moved by how much; printed, a summary, and what could not be repaired.

    Raises:
      ConfigError: a file is no layout, layouts are of several pools or supports, or a limit is out of range.
      BankError: there is no such bank or scene, or `out` cannot be written.
      PoolError: there is no such pool, object or support.
    """
    from cluttergen_jax.generation.repair import read_layouts, repair_layouts
    from cluttergen_jax.placement.repair import RepairConfig

    limits = RepairConfig(max_shift, max_turn_deg)
    # A bank is held by who writes it.
    with hold_file(out if Path(out).suffix == ".json" else None):
        given = read_layouts(source, pool, support, scene_numbers(scenes))
        return repair_layouts(given, Path(out), limits, overwrite)


@with_kept_programs
@takes_spec(_NOT_BY_HAND)
@in_groups(how_many="seed", files="out overwrite", machine="host port browser")
def place_by_hand(
    out: str | Path = "out/hand",
    *,
    seed: int = 0,
    overwrite: bool = False,
    host: str = "localhost",
    port: int = 8080,
    browser: bool = True,
    show: Callable[[str], None] = print,
    **options: Unpack[SceneOptions],
) -> GeneratedBank:
    """Has a person place objects in a browser until Ctrl-C, and keeps the scenes (`cluttergen view --place`).

    Each object is dragged and turned, lowered to first contact and let go; the attempt is judged by the rules
    that methods obey, as often as the person likes. A scene is kept as soon as it is saved or given up, in a
    bank of method "hand" whose column `seconds` tells what it took; the same call adds scenes to it. The
    arguments that are not explained here are those of `SceneSpec`.

    Args:
      out: the bank's folder, or a URL; a hand-made bank with the same settings is continued.
      seed: draws each scene's objects, 0 to 4294967295.
      overwrite: begin anew if the folder holds another bank.
      host: the address to listen on; 0.0.0.0 lets other machines in, if they have the token.
      port: 0 takes any free one.
      browser: open a browser.
      show: is given the lines that tell where the panel is, and what was kept.
      options: fields of `SceneSpec`.

    Returns:
      The bank; printed, it tells how well it went.

    Raises:
      ConfigError, PoolError: as `make_sampler`; or the port is taken.
      BankError: the folder holds something else, cannot be written, or is being written by another process.
      MissingExtraError: the extra `viewer` is not installed.
    """
    from cluttergen_jax.generation.hand import HandBank, hand_setup
    from cluttergen_jax.generation.sources.viewing import place_web

    check_range("seed", seed, 0, _MOST, 0)
    spec = replace(spec_of(place_by_hand, None, options), engine="native")

    def open_bank() -> HandBank:
        return HandBank(out, hand_setup(spec), spec.boxes(), seed, overwrite)

    return place_web(open_bank, host, port, browser, show)
