"""How firmly finished scenes stand: shaken, with other physics, in other engines, with tilted gravity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.evaluation.comparison import Column, number, share, share_of, table_of
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import Trial, grid
from cluttergen_jax.judging.scene_models import (
    SceneModels,
    TiltConfig,
    contacts_of,
    movement,
    shake,
    tilt,
)
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.placement.methods.table import BASELINES
from cluttergen_jax.statistics import finite, proportion
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict
from studies.cells import HEAD, SCENES, columns_of, number_column
from studies.measures.changed_physics import survives
from studies.measures.survival import PEERS, SURVIVAL_SECONDS, movement_elsewhere
from studies.methods.diversity import TIGHT, scenes_of
from studies.rankings import share_notes
from studies.results import Result
from studies.rules import RULES, margin_of
from studies.study import (
    Findings,
    Scale,
    Study,
    Successes,
    each_success,
    measure_each,
    measured_rows,
    of_methods,
    row_of,
)


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Few scenes: a minute is simulated of each."""
    return scenes_of(scale, 64, 4)


def arrays_of(scenes: Successes) -> tuple[SceneModels, np.ndarray, np.ndarray]:
    """Models, poses and who is placed, as measures take them."""
    return SceneModels(scenes.world), scenes.poses, scenes.is_placed


# Creep, shaking, and changed physics.

CREEP_SECONDS = (1.0, 10.0, 60.0)


def _withstood(scenes: Successes, num_threads: int) -> Row:
    arrays = arrays_of(scenes)
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
        *columns_of(
            range(len(seconds)), lambda n: f"median creep {seconds[n]:g} s, micrometres", median
        ),
        Column("shake, m/s^2", shake_text),
    )
    changes = columns_of(
        made["changes"], str, lambda row, name: share(row["changes"][name]["share"])
    )
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

MARGIN_ASKED = Column(
    "margin asked for, mm", lambda row: number(row.get("min_margin", 0.0), 0, 1e3)
)


def _with_margins(scale: Scale) -> tuple[Trial, ...]:
    """The scenes of `robustness`, without a margin and with the one that `generate` asks for."""
    rows = of_methods(trials(scale), *BASELINES, "guided", "policy")
    return tuple(each for trial in rows for each in grid(trial, min_margin=(0.0, MIN_MARGIN)))


def _measure_margins(runner: Runner, trial: Trial, scenes: Successes) -> Iterator[Row]:
    """Margins and tilt, beside the trial's success."""
    figures = runner.row(trial)["figures"]
    found = Row(success=figures["success"], low95=figures["low95"], high95=figures["high95"])
    found["unsupported"] = (
        figures["verdicts"].get(Verdict.UNSUPPORTED.label, 0) / figures["attempts"]
    )
    yield (
        found
        | runner.measure(trial, "margins", partial(_margins, scenes, runner.num_threads))
        | runner.measure(trial, "tilt", partial(tilt_shares, scenes, runner.num_threads))
    )


def _margins(scenes: Successes, num_threads: int) -> Row:
    least = np.nanmin(contacts_of(*arrays_of(scenes), num_threads).margin, axis=1)
    return Row(
        scenes=len(scenes),
        margin=[float(each) for each in np.percentile(least, [0, 10, 50])],
        below=float((least < MIN_MARGIN).mean()),
    )


def tilt_shares(scenes: Successes, num_threads: int) -> Row:
    """For each tilt of gravity, the share of scenes that stand whatever its direction."""
    config = TiltConfig()
    stands = tilt(*arrays_of(scenes), config, num_threads)
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
        *columns_of(
            range(len(angles)), lambda n: f"stand tilted {angles[n]['degrees']:g} deg", tilt_text
        ),
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
        for engine, found in survival_of(
            runner, trial, dict.fromkeys(PEERS, scenes), findings.notes
        ):
            findings.rows.append(row_of(trial, {"engine": engine}, found))
    return findings


def survival_of(
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
    moved = movement_elsewhere(engine, *arrays_of(scenes), num_threads=num_threads)
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
