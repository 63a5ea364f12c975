"""How firmly finished scenes stand: shaken, with other physics, in other engines, with tilted gravity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cluttergen_jax.assets.pool import ALL
from cluttergen_jax.config import TRUSTED_METHODS
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.evaluation.cells import (
    COST,
    EFFORT_NOTES,
    HEAD,
    SCENES,
    SUCCESS,
    Column,
    columns_of,
    number,
    number_column,
    request_columns,
    share,
    share_of,
    table_of,
)
from cluttergen_jax.evaluation.measures.contacts import contacts_of
from cluttergen_jax.evaluation.measures.robustness import (
    RobustConfig,
    TiltConfig,
    robust,
    shake,
    survives,
    tilt,
)
from cluttergen_jax.evaluation.measures.scene_models import SceneModels
from cluttergen_jax.evaluation.measures.simulate import movement
from cluttergen_jax.evaluation.measures.survival import PEERS, SURVIVAL_SECONDS, movement_elsewhere
from cluttergen_jax.evaluation.rankings import share_notes
from cluttergen_jax.evaluation.records import Result, Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.studies.diversity import TIGHT, scenes_of
from cluttergen_jax.evaluation.studies.rules import RULES, margin_of, named_rows
from cluttergen_jax.evaluation.studies.study import (
    Findings,
    Scale,
    Study,
    Successes,
    each_success,
    grid,
    measure_each,
    measured_rows,
    of_methods,
    row_of,
)
from cluttergen_jax.evaluation.trial import ROBUST, Trial
from cluttergen_jax.placement.baselines import BASELINES
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.statistics import finite, proportion
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Few scenes: a minute is simulated of each."""
    return scenes_of(scale, 64, 4)


def _arrays(scenes: Successes) -> tuple[SceneModels, np.ndarray, np.ndarray]:
    return SceneModels(scenes.world), scenes.poses, scenes.is_placed


# Creep, shaking, and changed physics.

CREEP_SECONDS = (1.0, 10.0, 60.0)


def _withstood(scenes: Successes, num_threads: int) -> Row:
    arrays = _arrays(scenes)
    creep = movement(*arrays, CREEP_SECONDS, num_threads)
    scores = shake(*arrays, num_threads=num_threads).min(1)
    standing = survives(*arrays, num_threads=num_threads)
    return Row(
        scenes=len(scenes),
        creep=[
            {
                "seconds": seconds,
                "median_shift": finite(np.median(creep.largest_shift[:, h])),
                **proportion(creep.survives()[:, h]),
            }
            for h, seconds in enumerate(CREEP_SECONDS)
        ],
        shake=[float(each) for each in np.percentile(scores, [10, 50, 90])],
        changes={name: proportion(each) for name, each in standing.items()},
    )


def _tables(result: Result) -> list[Table]:
    """Creep and shake, then changed physics."""
    rows = measured_rows(result)
    made = next((row for row in rows if "creep" in row), Row(creep=[], changes={}))
    seconds = [each["seconds"] for each in made["creep"]]

    def stands(row: Row, place: int) -> str:
        return share(row["creep"][place]["share"])

    def median(row: Row, place: int) -> str:
        return number(row["creep"][place]["median_shift"], 2, 1e6)

    def shake_text(row: Row) -> str:
        low, median, high = row["shake"]
        return f"{median:.2f} [{low:.2f}, {high:.2f}]"

    columns = (
        *HEAD,
        SCENES,
        *columns_of(range(len(seconds)), lambda n: f"stands {seconds[n]:g} s", stands),
        *columns_of(range(len(seconds)), lambda n: f"median creep {seconds[n]:g} s, micrometres", median),
        Column("shake, m/s^2", shake_text),
    )
    changes = columns_of(made["changes"], str, lambda row, name: share(row["changes"][name]["share"]))
    notes = (
        "stands: nothing moved over 5 mm or turned over 5 degrees; creep: the largest movement in a scene",
        "shake: sideways acceleration of the table at which something has moved 5 mm, the weaker of two "
        "directions, median [10 %, 90 %] of scenes",
    )
    second = "Share of scenes that stand 10 s under changed physics"
    margin = margin_of(rows)
    stood = [Row(row, **row["creep"][1]) for row in rows if len(row.get("creep", ())) > 1]  # type: ignore
    compared = share_notes(stood, lambda row: f"stands {row['seconds']:g} s on {row['support']}")
    return [
        table_of(result["title"] + margin, columns, rows, (*notes, *RULES, *compared)),
        table_of(second + margin, (*HEAD, *changes), rows, notes[:1]),
    ]


ROBUSTNESS = Study(
    "robustness",
    "Creep, shaking and changed physics",
    64,
    trials,
    make_tables=_tables,
    measure=measure_each(
        lambda runner, trial, scenes: [
            runner.measure(trial, "robustness", partial(_withstood, scenes, runner.num_threads))
        ]
    ),
    keeps_each=True,
)

# Support margins, and what tilted gravity topples.

MARGIN_ASKED = Column("margin asked for, mm", lambda row: number(row.get("min_margin", 0.0), 0, 1e3))


def _with_margins(scale: Scale) -> tuple[Trial, ...]:
    """The scenes of `robustness`, without a margin and with the one that `generate` asks for."""
    rows = of_methods(trials(scale), *BASELINES, "guided", "policy")
    return tuple(each for trial in rows for each in grid(trial, min_margin=(0.0, MIN_MARGIN)))


def _measure_margins(runner: Runner, trial: Trial, scenes: Successes) -> Iterator[Row]:
    """Margins and tilt, beside the trial's success."""
    figures = runner.row(trial)["figures"]
    found = Row(success=figures["success"], low95=figures["low95"], high95=figures["high95"])
    found["unsupported"] = figures["verdicts"].get(Verdict.UNSUPPORTED.label, 0) / figures["attempts"]
    yield (
        found
        | runner.measure(trial, "margins", partial(_margins, scenes, runner.num_threads))
        | runner.measure(trial, "tilt", partial(_tilt_shares, scenes, runner.num_threads))
    )


def _margins(scenes: Successes, num_threads: int) -> Row:
    least = np.nanmin(contacts_of(*_arrays(scenes), num_threads).margin, axis=1)
    return Row(
        scenes=len(scenes),
        margin=[float(each) for each in np.percentile(least, [0, 10, 50])],
        below=float((least < MIN_MARGIN).mean()),
    )


def _tilt_shares(scenes: Successes, num_threads: int) -> Row:
    config = TiltConfig()
    stands = tilt(*_arrays(scenes), config, num_threads)
    return Row(
        tilt=[
            {"degrees": by, "directions": float(each.mean()), **proportion(each == 1)}
            for by, each in zip(config.degrees, stands.T, strict=True)
        ]
    )


def _margin_columns(rows: list[Row]) -> tuple[Column, ...]:
    angles = next((row["tilt"] for row in rows if "tilt" in row), [])

    def least(row: Row) -> str:
        least, tenth, median = (f"{1e3 * each:.1f}" for each in row["margin"])
        return f"{median} [{least}, {tenth}]"

    def tilt_text(row: Row, place: int) -> str:
        return f"{share(row['tilt'][place]['share'])} ({share(row['tilt'][place]['directions'])})"

    return (
        *HEAD,
        MARGIN_ASKED,
        Column("success [95 %]", share_of),
        Column("attempts unsupported", lambda row: share(row["unsupported"])),
        SCENES,
        Column("least margin of a scene, mm", least),
        Column(f"scenes below {1e3 * MIN_MARGIN:g} mm", lambda row: share(row["below"])),
        *columns_of(range(len(angles)), lambda n: f"stand tilted {angles[n]['degrees']:g} deg", tilt_text),
    )


MARGIN = Study(
    "margin",
    "Support margins and tilted gravity",
    64,
    _with_margins,
    _margin_columns,
    (
        "support margin: distance in plan of an object's centre of mass to the edge of the polygon of the "
        "contacts that carry it; of the object of a scene that has least: median [least, 10 %] of scenes",
        "stand tilted: share of scenes in which nothing moves over 5 mm or turns over 5 degrees within 2 s, "
        "in whichever of eight directions gravity is tilted; in brackets, of scenes and directions",
        *RULES,
    ),
    measure_each(_measure_margins),
    keeps_each=True,
)

# The share of scenes that stand 10 s in PyBullet and in Drake, where they are installed.


def _measure_survival(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Every trial in every engine."""
    findings = Findings()
    for trial, scenes in each_success(runner, trials, findings.rows):
        for engine, found in _survival(runner, trial, dict.fromkeys(PEERS, scenes), findings.notes):
            findings.rows.append(row_of(trial, {"engine": engine}, found))
    return findings


def _survival(
    runner: Runner, trial: Trial, scenes_of: dict[str, Successes], notes: list[str]
) -> Iterator[tuple[str, Row]]:
    """How a trial's scenes do in each engine; a note says which one is not installed."""
    for engine, scenes in scenes_of.items():
        make = partial(_survival_in, scenes, engine, runner.num_threads)
        try:
            yield engine, runner.measure(trial, f"survival in {engine}", make)
        except MissingExtraError as error:
            if (note := f"{engine}: {error}") not in notes:
                notes.append(note)


def _survival_in(scenes: Successes, engine: str, num_threads: int) -> Row:
    moved = movement_elsewhere(engine, *_arrays(scenes), num_threads=num_threads)
    return Row(
        seconds=SURVIVAL_SECONDS[0],
        scenes=len(scenes),
        median_shift=finite(np.median(moved.largest_shift[:, 0])),
        **proportion(moved.survives()[:, 0]),  # type: ignore[typeddict-item]
    )


def _survival_tables(result: Result) -> list[Table]:
    """A line for each method, table and engine."""
    rows = measured_rows(result)
    has_margins = len({row.get("min_margin", 0.0) for row in rows}) > 1
    columns = (
        *HEAD,
        *((MARGIN_ASKED,) if has_margins else ()),
        Column("engine", lambda row: row["engine"]),
        SCENES,
        Column("stands 10 s [95 %]", lambda row: share_of(row, "share")),
        number_column("median of the largest movement, mm", "median_shift", 2, 1e3),
    )
    notes = (
        "stands: nothing moved over 5 mm or turned over 5 degrees",
        *RULES,
        *share_notes(rows, lambda row: f"stands 10 s in {row.get('engine')} on {row['support']}"),
    )
    # Of several margins, a column tells them apart.
    title = result["title"] + ("" if has_margins else margin_of(rows))
    return [table_of(title, columns, rows, notes)]


SURVIVAL = Study(
    "survival",
    "The same scenes in another engine",
    64,
    trials,
    make_tables=_survival_tables,
    measure=_measure_survival,
    keeps_each=True,
)
MARGIN_SURVIVAL = replace(
    SURVIVAL,
    name="margin_survival",
    title="What a support margin does for survival in another engine",
    # The policy on the tight table, with and without a support margin.
    trials=lambda scale: tuple(
        each for each in _with_margins(scale) if (each.method, each.support) == ("policy", TIGHT)
    ),
)

# Robust scenes: what asking for them costs, and what they withstand that others do not.

ROWS = tuple(
    name for method in ("drop, ruin", "spread", "guided") for name in (method, f"{method}, {ROBUST}")
)
"""Each method without and with robust scenes asked for."""
STACKED = "stack=3"
"""Clutter of the rows with objects on others, of the methods that can be asked for it."""
DEGREES = (2.0, 5.0)
"""Tilts that are shown, of those that are measured."""
_MOST = {"drake": {10: 32, 30: 8}}
"""Scenes that are simulated in an engine, by their number of objects, where that takes minutes a scene."""
_CROWD = 30
"""Objects of the crowded rows. Each of their scenes takes more than ten times as long to tilt and to simulate
elsewhere, so that they have a quarter of the trials."""


def _robust_rows(scale: Scale) -> tuple[Trial, ...]:
    """Ten objects on a tight table, thirty of every pool on the paper's, and ten with some on others."""
    base = scale.trial(256, 4)
    tight = grid(base, pool=scale.pools_or("dining"), support=(TIGHT,))
    stacked = [replace(each, clutter=STACKED) for each in tight]
    crowd = replace(base, pool=ALL, num_objects=_CROWD, trials=-(-base.trials // 4))
    return (
        *named_rows([*tight, crowd], *ROWS),
        *named_rows(stacked, *(name for name in ROWS if name.split(", ")[0] in TRUSTED_METHODS)),
    )


def _measure_stability(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Success and cost of every trial; of its scenes, tilt, `robust` and survival in other engines."""
    findings, threads = Findings(), runner.num_threads
    for trial, scenes in each_success(runner, trials, findings.rows):
        found = Row(objects=trial.num_objects, figures=runner.row(trial)["figures"])
        tilts = runner.measure(trial, "tilt", partial(_tilt_shares, scenes, threads))["tilt"]
        found["tilt"] = [each for each in tilts if each["degrees"] in DEGREES]
        stands = partial(robust, *_arrays(scenes), num_threads=threads)
        found["robust"] = runner.measure(trial, ROBUST, lambda stands=stands: proportion(stands()))  # type: ignore
        some = {name: scenes.first(_MOST.get(name, {}).get(trial.num_objects)) for name in PEERS}
        found["survival"] = dict(_survival(runner, trial, some, findings.notes))  # type: ignore[arg-type]
        findings.rows.append(row_of(trial, found))
    return findings


def _stability_columns(rows: list[Row]) -> tuple[Column, ...]:
    engines = dict.fromkeys(engine for row in rows for engine in row.get("survival", ()))

    def survival(row: Row, engine: str) -> str:
        found = row["survival"].get(engine)
        return share_of(found, "share") if found else "-"

    return (
        *request_columns("pool", support="table"),
        Column("objects", lambda row: str(row.get("objects", "-")), is_asked=True),
        *request_columns("method"),
        SUCCESS,
        *COST,
        *columns_of(
            range(len(DEGREES)),
            lambda place: f"stand tilted {DEGREES[place]:g} deg, every direction",
            lambda row, place: share_of(row["tilt"][place], "share"),
        ),
        Column(ROBUST, lambda row: share_of(row["robust"], "share")),
        *columns_of(engines, lambda engine: f"stands 10 s in {engine}", survival),
    )


def _stability_notes(rows: list[Row]) -> Iterable[str]:
    config = RobustConfig()
    plain = [row for row in rows if "missing" not in row and STACKED not in row["method"]]
    return (
        f"`, {ROBUST}`: what is placed must also stand under a slight tilt with less "
        "friction and softer contacts (`--robust`)",
        "stand tilted: share of scenes in which nothing moves over 5 mm or turns over 5 degrees within 2 s, "
        "whichever of eight directions gravity is tilted in",
        f"{ROBUST}: nothing moves over 5 mm in plan or turns over 5 degrees with gravity tilted by "
        f"{config.degrees:g} degrees in {config.num_directions} directions, {config.friction:g} of the "
        "friction and MuJoCo's default contact",
        f"rows of {_CROWD} objects have a quarter of the trials; Drake has the first "
        f"{_MOST['drake'][10]} scenes that stand, {_MOST['drake'][_CROWD]} of {_CROWD} objects",
        EFFORT_NOTES[1],
        *RULES,
        *share_notes(
            [Row(row, **row["robust"]) for row in plain],  # type: ignore
            lambda row: f"{ROBUST}, {row['pool']}, {row['objects']} objects",
        ),
    )


STABILITY = Study(
    "stability",
    "Robust scenes, asked for and not",
    256,
    _robust_rows,
    _stability_columns,
    _stability_notes,
    _measure_stability,
    says_margin=True,
    keeps_each=True,
)
