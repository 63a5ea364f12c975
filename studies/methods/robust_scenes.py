"""Robust scenes: what asking for them costs, and what they withstand that others do not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from cluttergen_jax.assets.pool import ALL
from cluttergen_jax.evaluation.comparison import SUCCESS, Column, request_columns, share_of
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.trial import ROBUST, Trial, grid
from cluttergen_jax.judging.scene_models import RobustConfig, robust
from cluttergen_jax.placement.methods.table import TRUSTED
from cluttergen_jax.statistics import proportion
from studies.cells import COST, EFFORT_NOTES, columns_of
from studies.measures.survival import PEERS
from studies.methods.diversity import TIGHT
from studies.methods.robustness import arrays_of, survival_of, tilt_shares
from studies.rankings import share_notes
from studies.rules import RULES, named_rows
from studies.study import Findings, Scale, Study, each_success, row_of

ROWS = tuple(
    name
    for method in ("drop, ruin", "spread", "guided")
    for name in (method, f"{method}, {ROBUST}")
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
    stacked = [each.replace(clutter=STACKED) for each in tight]
    crowd = base.replace(pool=ALL, num_objects=_CROWD, trials=-(-base.trials // 4))
    return (
        *named_rows([*tight, crowd], *ROWS),
        *named_rows(stacked, *(name for name in ROWS if name.split(", ")[0] in TRUSTED)),
    )


def _measure_stability(runner: Runner, trials: Sequence[Trial], stem: Path) -> Findings:
    """Success and cost of every trial; of its scenes, tilt, `robust` and survival in other engines."""
    findings = Findings()
    threads = runner.num_threads
    for trial, scenes in each_success(runner, trials, findings.rows):
        found = Row(objects=trial.num_objects, figures=runner.row(trial)["figures"])
        tilts = runner.measure(trial, "tilt", partial(tilt_shares, scenes, threads))["tilt"]
        found["tilt"] = [each for each in tilts if each["degrees"] in DEGREES]
        stands = partial(robust, *arrays_of(scenes), num_threads=threads)
        found["robust"] = runner.measure(trial, ROBUST, lambda stands=stands: proportion(stands()))  # type: ignore
        some = {name: scenes.first(_MOST.get(name, {}).get(trial.num_objects)) for name in PEERS}
        found["survival"] = dict(survival_of(runner, trial, some, findings.notes))  # type: ignore[arg-type]
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
