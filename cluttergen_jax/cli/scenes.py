"""The commands about scenes: made, judged, kept, published, shown."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import Positional, arg

from cluttergen_jax.api.export import (
    cut,
    export,
    holds_policies,
    pull_bank,
    pull_policies,
    push_bank,
)
from cluttergen_jax.api.generate import generate, place_by_hand, repair
from cluttergen_jax.api.render import make_dataset, render, view
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.options import NOTHING_WRITTEN, Options, command
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.judging.api import certify, judge, verify

if TYPE_CHECKING:
    from cluttergen_jax.judging.sense import SenseFindings
    from cluttergen_jax.scene.bank import Bank


@command(
    generate,
    num_scenes=Annotated[int, arg(aliases=["-n"])],
    region=str | None,
    keep_out=tuple[str, ...],
    clutter=str | None,
    everyday="num_scenes pool objects num_objects support region method natural relations seed render out",
)
def run_generate(options: Options) -> None:
    """Generate verified cluttered scenes and save them as a bank.

    Example: `cluttergen generate --pool dining --num-scenes 100 --out bank`
    """
    bank = options.call(generate, only_changed=options.layout is not None)
    print(with_flags(str(bank), options))


@command(verify, path=Positional[str], told_when_stopped=NOTHING_WRITTEN)
def run_verify(options: Options) -> int:
    """Check that saved scenes are stable, in plain MuJoCo. Exit status 1 if one is not.

    Of a bank, its files are compared with the digests in bank.json as well, and each scene's file with its
    row: a scene of which something was changed does not count.

    Example: `cluttergen verify out`
    """
    report = options.call(verify)
    print(report)
    if report.unwritten:
        print(f"note: {report.unwritten}", file=sys.stderr)
    return 0 if report.is_sound else 1


@command(certify, bank=Positional[str])
def run_certify(options: Options) -> None:
    """Add a stability certificate to each successful scene of a bank, a column for each measure.

    Residual speed, drift, overlap, contacts, shake score, the contact graph, support margins, and what tilted
    gravity topples. Rerun to resume.

    Example: `cluttergen certify out --seconds 10`
    """
    found = options.call(certify)
    print(
        f"{len(found.shake)} scenes that stand have their certificate ({found.num_new} rows are new); "
        f"shake score: median {np.median(found.shake):.2f}, least {found.shake.min():.2f} m/s^2"
    )


@command(judge, paths=Positional[tuple[str, ...]], states=str | None, sense=bool)
def run_judge(options: Options) -> int:
    """Judge anybody's scenes by one strict rule: MJCF, URDF, SDF or USD files, or arrays of starts.

    Exit status 1 if a file could not be judged; the others are.

    Example: `cluttergen judge kitchen.xml --states starts.npz --hold-joints --sense --out judged`
    """
    report = options.call(judge)
    print(report)
    return 1 if report.unread else 0


@command(repair, source=Positional[str])
def run_repair(options: Options) -> int:
    """Make broken layouts stable with little motion: noisy poses, JSON of a language model.

    Exit status 1 if one is not stable afterwards.

    Example: `cluttergen repair layout.json --pool dining --out repaired`
    """
    report = options.call(repair)
    print(report)
    return 0 if all(each.is_stable for each in report.layouts) else 1


@command(export, source=Positional[str], format=str, told_when_stopped=NOTHING_WRITTEN)
def run_export(options: Options) -> None:
    """Write scenes of a bank as a self-contained folder for another program.

    Example: `cluttergen export out --format urdf --scenes 0-9 --out elsewhere`
    """
    from cluttergen_jax.scene.export import BANK_FORMATS
    from cluttergen_jax.scene.export.folder import num_exported
    from cluttergen_jax.scene.export.formats import find_format

    own = {"old_mujoco": options.old_mujoco, "joints": options.joints}
    kind = BANK_FORMATS.get(options.format) or find_format(options.format, **own)
    is_whole = options.format in BANK_FORMATS
    folder = options.call(export, format=options.format if is_whole else kind)
    print(f"{num_exported(folder)} scenes in {folder}: open with {kind.opens_in}")


@command(cut, bank=Positional[str], scenes=str)
def run_cut(options: Options) -> None:
    """Make a bank of some scenes of another, numbered anew from 0. Rerun to resume.

    Example: `cluttergen cut out --scenes 0-99 --out smaller`
    """
    bank = options.call(cut)
    print(f"{bank.num_scenes} scenes in {bank.path}")


def _sense_of(bank: Bank) -> SenseFindings:
    """What the bank's own table of sense, else the package's, says of its scenes."""
    from cluttergen_jax.assets.sense import read_sense
    from cluttergen_jax.judging.sense import sense_of_bank

    return sense_of_bank(bank, read_sense(bank.recipe.get("placement", {}).get("sense", "")))


@command()
def run_stats(
    path: Positional[str], card: bool = False, sense: bool = False, json: bool = False
) -> None:
    """Show what a bank holds: successes, failures by reason, objects, attempts, duplicates, gaps.

    Example: `cluttergen stats out --card`

    Args:
      path: a bank.
      card: write the dataset card, README.md, into the bank's folder again (`generate` writes it too).
      sense: tell, too, how much sense the first thousand scenes make, as `cluttergen judge --sense` does.
      json: print JSON.
    """
    from cluttergen_jax.kept_folder import hold_folder
    from cluttergen_jax.scene.bank import CARD, read_bank, stats_of, write_card

    bank = read_bank(path)
    stats = stats_of(bank)
    record = stats.as_json()
    text = str(stats)
    if sense:
        found = _sense_of(bank)
        record["sense"] = found.record()
        text = "\n".join([text, *found.lines()])
    print(json_text.dumps(record, indent=1) if json else text)
    if card:
        with hold_folder(bank.path):
            written = write_card(read_bank(bank.path))
        if not json:
            print(f"card       {written or f'left alone: {bank.path / CARD} is your own'}")


@command(push_bank, path=Positional[str], name=Positional[str])
def run_push(options: Options) -> None:
    """Publish a bank as a data set on the Hugging Face Hub (extra `hub`), with its card.

    The bank is checked first, and replaces an earlier one of that name in one commit.

    Example: `cluttergen push out me/breakfast`
    """
    from cluttergen_jax.scene.bank import local_paths, read_bank

    for path in local_paths(read_bank(options.path)):
        print(f"note: the bank's record names a path of this machine, and will show it: {path}")
    print(f"pushed     {options.call(push_bank)}")


@command(pull_bank, name=Positional[str])
def run_pull(options: Options) -> None:
    """Fetch a bank, or policies, from the Hugging Face Hub (extra `hub`) and check every file of it.

    Rerun to resume.

    Example: `cluttergen pull me/breakfast --out breakfast`
    """
    from cluttergen_jax.scene.bank import read_bank

    if holds_policies(options.name, options.hub, options.revision):
        where = "for a data set of policies"
        names = options.call(pull_policies, where, "leaving it out: methods find them by name")
        print(f"pulled     {len(names)} checkpoints: {', '.join(names)}")
        return
    out = options.out or PurePosixPath(options.name).name
    bank = read_bank(options.call(pull_bank, out=out))
    checked = "every file was checked" if bank.files else "it has no digests of its files"
    print(f"pulled     {bank.num_scenes} scenes to {bank.path}; {checked}")


@command(
    view,
    place_by_hand,
    left_out=("block",),
    source=Positional[str | None],  # type: ignore[misc]
    region=str | None,
    keep_out=tuple[str, ...],
    place=Annotated[
        bool,
        arg(
            help="place objects by hand (by default of dining, on the paper's table), and keep the scenes."
        ),
    ],
    everyday="place pool num_objects support region method browser port out",
)
def run_view(options: Options) -> None:
    """Look at scenes in a browser: objects, hulls, clouds, attempts, and new scenes when asked for.

    Example: `cluttergen view out`, or `cluttergen view --pool dining --method drop`; to make scenes by hand,
    `cluttergen view --place --pool dining --num-objects 5 --out mine`
    """
    # The web viewer runs until Ctrl-C; whoever reads the address from a pipe waits for it.
    show = partial(print, flush=True)
    if options.place:
        hint = "leaving it out: scenes made by hand have their own bank"
        bank = options.call(place_by_hand, "with --place", hint, ("place",), show=show)
        print(with_flags(str(bank), options))
    else:
        options.call(view, "without --place", "--place, to make scenes by hand", show=show)


@command(
    render,
    source=Positional[str],
    told_when_stopped="what is finished is kept; the same command draws all again",
    everyday="scenes picture sheet turntable replay film depth segmentation cameras size quality out",
)
def run_render(options: Options) -> int:
    """Draw scenes: pictures (PNG), films, contact sheets, and what a camera or a scanner would measure.

    Example: `cluttergen render out --sheet --turntable`
    """
    report = options.call(render)
    for path in report.paths:
        print(path)
    for note in report.notes:
        print(f"note: {with_flags(note, options)}", file=sys.stderr)
    if report.failures:
        print(with_flags(failures_text(report.failures), options), file=sys.stderr)
    return 1 if report.failures else 0


def failures_text(failures: Sequence[tuple[str, ClutterGenError]]) -> str:
    """What could not be made and why, a line each; what to try, once."""
    lines = [f"error: {len(failures)} could not be made, the rest was:"]
    lines += [f"  {name}: {error.given}" for name, error in failures]
    hints = dict.fromkeys(error.hint for _, error in failures if error.hint)
    return "\n".join([*lines, *(f"Try: {hint}." for hint in hints)])


@command(
    make_dataset,
    banks=Positional[tuple[str, ...]],
    everyday="cameras size form splits num_scenes vary quality out",
)
def run_dataset(options: Options) -> None:
    """Make a dataset of views of banks: colour, depth, labels, masks, poses. Rerun to resume.

    Example: `cluttergen dataset bank --cameras free:4 --size 320x240 --splits train=0.9,test=0.1`
    """
    print(options.call(make_dataset))
