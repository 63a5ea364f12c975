"""The suite `downstream`: what scenes are good for, as studies that stand on the page of results."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cluttergen_jax.downstream.placer.evaluation.evaluate import PlacerComparison, Trials, compare_placers
from cluttergen_jax.downstream.placer.evaluation.tables import tables_of
from cluttergen_jax.downstream.placer.heads.trained import embedded_placers
from cluttergen_jax.downstream.placer.pairs.stored import PairSet
from cluttergen_jax.downstream.placer.proposers import BASELINES, FULL_STATE
from cluttergen_jax.errors import ConfigError, closest
from cluttergen_jax.evaluation.machine import machine
from cluttergen_jax.evaluation.report import Result, document, write_report
from cluttergen_jax.evaluation.store import FORMAT, Store
from cluttergen_jax.files import write_atomically

NAME = "downstream"
PLACEMENT = "placement"
_TITLE = "Stable placement from one camera's view"
_SCENES, _QUICK_SCENES = 100, 2
_OBJECTS = 10
_NOISES = (0.0, 1.0)


@dataclass(frozen=True)
class PlacementSet:
    """Queries that placers are compared on: scenes of a pool on a support, one unseen camera a query."""

    name: str
    pool: str
    support: str = "table"


SETS = (
    PlacementSet("household", "household"),
    PlacementSet("small-table", "household", "table-0.40x0.50"),
    PlacementSet("dining", "dining"),
    PlacementSet("kitchen", "kitchen"),
    PlacementSet("office", "office"),
    PlacementSet("study", "study"),
)

MakeData = Callable[..., PairSet]


def run_downstream(
    make_data: MakeData,
    folder: Path,
    only: Sequence[str],
    pools: Sequence[str],
    quick: bool,
    seed: int,
    num_threads: int,
    fresh: bool,
    show: Callable[[Result], None],
) -> list[Result]:
    """The studies of the suite, each written as it is done; see `cluttergen_jax.evaluate_suite`.

    Args:
      make_data: `cluttergen_jax.placer_data`.
      pools: of the sets; all if empty.

    Raises:
      ConfigError: there is no such study, or no set of these pools.
    """
    for each in only:
        if each != PLACEMENT:
            raise ConfigError(
                f"only = {each!r} in suite {NAME!r}", PLACEMENT, meant=closest(each, [PLACEMENT])
            )
    sets = [one for one in SETS if not pools or one.pool in pools][: 1 if quick else None]
    if not sets:
        raise ConfigError(
            f"pools = {', '.join(pools)!r} with suite {NAME!r}", ", ".join(s.pool for s in SETS)
        )
    scenes = _QUICK_SCENES if quick else _SCENES
    words = ["cluttergen evaluate --suite downstream", *(["--quick"] if quick else [])]
    words += [f"--pools {' '.join(pools)}"] if pools else []
    words += [f"--seed {seed}"] if seed else []
    store = Store(folder / "results")
    found = []
    for one in sets:
        place = folder / "data" / f"{one.name}-{scenes}-{seed}"
        pairs = make_data(
            place,
            pool=one.pool,
            support=one.support,
            num_scenes=scenes,
            num_objects=_OBJECTS,
            split="test",
            seed=seed,
            num_threads=num_threads,
        )
        trials = Trials(pairs, "test", None, seed, store, fresh, num_threads)
        found.append(_compared(trials, quick))
    result = result_of(found, " ".join(words), quick)
    write_report(result, folder)
    show(result)
    write_atomically(folder / "all.md", document([result], link="").encode())
    return [result]


def _compared(trials: Trials, quick: bool) -> PlacerComparison:
    """Baselines with and without noise; what sees the scene itself, once."""
    placers = ("random", "geometry") if quick else (*BASELINES, *embedded_placers())
    seen = compare_placers(trials, placers, _NOISES, None)
    if quick:
        return seen
    whole = compare_placers(trials, FULL_STATE, (0.0,), None)
    rows = [*seen.rows, *whole.rows]
    return PlacerComparison(rows, tables_of(rows))


def result_of(found: Sequence[PlacerComparison], command: str, quick: bool) -> Result:
    """Comparisons on several sets as one study of the page of results, its tables made already.

    The first set is told in full, of the others the main table.
    """
    tables = [*found[0].tables, *(each.tables[0] for each in found[1:])]
    records: list[dict[str, Any]] = [row for each in found for row in each.rows]
    return {
        "format": FORMAT,
        "suite": NAME,
        "name": PLACEMENT,
        "title": _TITLE,
        "command": command,
        "quick": quick,
        "size": 1,
        "trials": sorted({row["trial"]["queries"] for row in records}),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": machine(),
        "records": records,
        "measure": None,
        "pictures": [],
        "tables": [asdict(table) for table in tables],
    }
