"""Studies of placers that differ in what they were trained on: rows by variant and seed, and their table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cluttergen_jax.downstream.placer.evaluate import (
    MAIN,
    NOTES,
    PlacerTrials,
    Row,
    main_cells,
    with_interval,
)
from cluttergen_jax.downstream.placer.scored import embedded_placers
from cluttergen_jax.downstream.placer.training import TESTING
from cluttergen_jax.statistics import wilson
from cluttergen_jax.tables import Table
from studies.downstream.suite_folder import (
    HOUSEHOLD,
    NUM_OBJECTS,
    SETS,
    VALIDATING,
    DownstreamScale,
    PlacementSet,
    SuiteFolder,
)
from studies.study import Findings, Study

SEEDS_NOTE = (
    "of several training seeds the mean; its interval is that of the queries that each was asked, since all "
    "were asked the same, and knows nothing of what differs from seed to seed"
)


class Variant(NamedTuple):
    """One way to train a placer.

    Attributes:
      labels: what a table says of it, by column; all but the noise.
      runs: the trained placers by training seed; a name for what is not trained.
    """

    labels: dict[str, str]
    runs: dict[int, Path] | str


def rows_of(
    trials: PlacerTrials, variants: Sequence[Variant], noises: Sequence[float]
) -> list[Row]:
    """Each variant's rows by noise and training seed, with its labels: `variant`, `training_seed`."""
    rows = []
    for noise in noises:
        for variant in variants:
            for seed, placer, name in _placers(variant.runs):
                row = trials.row(placer, noise, name=name)
                rows.append(row | {"variant": variant.labels, "training_seed": seed})
    return rows


def _placers(runs: dict[int, Path] | str) -> list[tuple[int | None, str, str]]:
    if isinstance(runs, str):
        return [(None, runs, runs)]
    return [(seed, str(run), run.name) for seed, run in runs.items()]


def group_by_seed(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows that differ in their training seed alone, together."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        trial = row["trial"]
        asked = {name: value for name, value in trial.items() if name != "placer"}
        groups.setdefault((*row["variant"].items(), *asked.items()), []).append(row)
    return list(groups.values())


def table_of(title: str, rows: Sequence[Row], notes: Sequence[str] = ()) -> Table:
    """The main table of variants, a line for all training seeds of one."""
    groups = group_by_seed(rows)
    columns = (*groups[0][0]["variant"], "noise", "seeds", MAIN[0], "each seed", *MAIN[1:])
    return Table(title, columns, tuple(map(_line, groups)), (*notes, SEEDS_NOTE, NOTES[1]))


def _line(rows: list[Row]) -> tuple[str, ...]:
    shares = [row["figures"]["success"]["share"] for row in rows]
    cells = main_cells(mean_figures(rows))
    return (
        *rows[0]["variant"].values(),
        f"{rows[0]['trial']['noise']:g}",
        "-" if rows[0]["training_seed"] is None else str(len(rows)),
        cells[0],
        "-" if len(rows) == 1 else " ".join(f"{share:.3f}" for share in shares),
        *cells[1:],
    )


def mean_figures(rows: Sequence[Row]) -> Any:
    """What `main_cells` reads of figures, as means over rows of the same queries."""
    queries = rows[0]["trial"]["queries"]
    figures = [row["figures"] for row in rows]
    shares = ("success", "best_of_all", "with_margin", "paper")
    verdicts = [each["verdicts"] for each in figures]
    errors = [each["z_error"]["median"] for each in figures]
    return {
        **{name: pool_shares([each[name] for each in figures], queries) for name in shares},
        "many": pool_shares([each["many"] for each in figures], queries),
        "z_error": {"median": None if None in errors else float(np.mean(errors))},
        "verdicts": {
            name: float(np.mean([each[name] for each in verdicts])) for name in verdicts[0]
        },
    }


def pool_shares(shares: Sequence[Mapping[str, Any]], queries: int) -> Any:
    """The mean of shares of the same queries, with the interval of a share of so many.

    Args:
      queries: where a share does not say itself of how many it is; where these differ, the fewest count.
    """
    values = [each["share"] for each in shares]
    if None in values:
        return {"share": None, "low95": None, "high95": None}
    mean = float(np.mean(values))
    number = min(int(each.get("queries", queries)) for each in shares)
    low, high = wilson(round(mean * number), number)
    return {"share": mean, "low95": low, "high95": high}


def _compare(
    suite: SuiteFolder, variants: Sequence[Variant], suffix: str, notes: Sequence[str]
) -> Findings:
    """Rows and a table of variants on the queries of household."""
    rows = rows_of(suite.trials(suite.test_set()), variants, suite.scale.noises)
    title = f"{rows[0]['trial']['queries']} queries of household{suffix}"
    return Findings(rows, tables=[table_of(title, rows, notes)])


def _table_of_sets(rows: Sequence[Row], suffix: str, notes: Sequence[str]) -> Table:
    queries = sorted({row["trial"]["queries"] for row in rows})
    title = f"{' or '.join(f'{each:,}' for each in queries)} queries a set{suffix}"
    return table_of(title, rows, notes)


# By how many pairs placers learned from.

SIZES = (200, 1000, 5000, 20_000)
_FEW_SCENES = 5000
"""Up to so many pairs are the first of one set, of 500 scenes; more are of a set of their own."""
_SIZE_NOTES = (
    "up to 5,000 pairs: the first so many of 5,000 of 500 scenes; 20,000 are of 2,000 scenes",
    "whatever their number, the epoch is chosen on 600 other pairs, of 60 scenes of their own",
    "every size is seen as often as the preset says: fewer pairs are fewer steps",
)


def _sizes(scale: DownstreamScale) -> list[tuple[str, int]]:
    """The head `scored` by size; more pairs than the scale allows are left out."""
    sizes = [size for size in SIZES if size <= (scale.most_pairs or size)] or [
        scale.pairs(SIZES[0])
    ]
    heads = scale.heads_or("scored")
    return [(head, size) for head in heads for size in sizes]


def _compare_sizes(suite: SuiteFolder, asked: Sequence[tuple[str, int]], stem: Path) -> Findings:
    variants = []
    for head, size in asked:
        num_scenes, num_pairs = (500, 5000) if size <= _FEW_SCENES else (2000, size)
        pairs = suite.training_set("household", num_scenes, num_pairs, VALIDATING)
        runs = suite.train(f"household-{head}-{size}", pairs, head, size)
        variants.append(Variant({"head": head, "pairs": f"{size:,}"}, runs))
    return _compare(suite, variants, ", by pairs learned from", _SIZE_NOTES)


SET_SIZE = Study(
    "set-size",
    "Placers by how many pairs they learned from",
    1,
    _sizes,
    measure=_compare_sizes,
    brings_tables=True,
)

# By how the scenes that they learned from came about.

SCENES = {"guided": 105, "clear": 105, "random": 180}
"""Of which about 100 stand: `random` fails more often."""
PAIRS = 1000
HAND_PAIRS = 200
HAND_SCENES = 20
_SOURCE_NOTES = (
    "each learns from its own scenes alone: every tenth of them chooses the epoch",
    "generated: 20 scenes by `guided`, where the paper has 200 pairs of 20 scenes that a person made "
    "(Human-200); nobody has made any here. That row is made by `cluttergen view --place --pool household "
    "--num-objects 10 --out hand`, twenty scenes, and then `python evaluate.py --suite downstream --only "
    "source --bank hand`",
)


def _compare_sources(suite: SuiteFolder, methods: Sequence[str], stem: Path) -> Findings:
    """The head `scored` by source, and by few pairs as a person would make them."""
    scale = suite.scale
    sets = []
    for method in methods:
        pairs = suite.training_set(f"household-{method}", SCENES[method], PAIRS, method=method)
        sets.append((method, scale.pairs(PAIRS), pairs))
    few = suite.training_set("household-few", HAND_SCENES, HAND_PAIRS, method="guided")
    sets.append(("generated", scale.pairs(HAND_PAIRS), few))
    if scale.bank is not None:
        hand = suite.hand_set(Path(scale.bank), scale.pairs(HAND_PAIRS))
        sets.append(("by hand", scale.pairs(HAND_PAIRS), hand))
    variants = []
    for head in scale.heads_or("scored"):
        for source, size, pairs in sets:
            runs = suite.train(f"{source.replace(' ', '-')}-{head}-{size}", pairs, head, size)
            number = str(pairs.split("train")["num_scenes"])
            labels = {"scenes by": source, "head": head, "pairs": f"{size:,}", "of scenes": number}
            variants.append(Variant(labels, runs))
    return _compare(suite, variants, ", by the scenes learned from", _SOURCE_NOTES)


SOURCE = Study(
    "source",
    "Placers by the scenes that they learned from",
    1,
    lambda scale: list(SCENES)[: 1 if scale.quick else None],
    measure=_compare_sources,
    brings_tables=True,
)

# The placer that comes with the package, trained again with other seeds.

# Of each of the two sets, and times that they are seen: as the placer's card has it.
CARD_PAIRS = 2560
EPOCHS = 10

_SEED_NOTES = (
    "trained by the commands of the card of the placer `scored`, each seed from pairs to weights",
)
_QUICK_NOTES = (
    "learned from household alone, where the placer `scored` learned from all pools as well",
)


def _compare_seeds(suite: SuiteFolder, sets: Sequence[PlacementSet], stem: Path) -> Findings:
    """Rows on all sets of the study `placement`."""
    scale = suite.scale
    learned = [suite.household()]
    if not scale.quick:
        all_pools = {"pool": "all", "num_objects": NUM_OBJECTS}
        learned.append(suite.training_set("all", 800, CARD_PAIRS, (100, 256), **all_pools))
    size = scale.pairs(CARD_PAIRS)
    runs = suite.train(f"card-{size}", learned, "scored", size, num_epochs=EPOCHS)
    rows = []
    for one in sets:
        variant = Variant({"set": one.name, "placer": "scored"}, runs)
        rows += rows_of(suite.trials(suite.test_set(one)), [variant], scale.noises)
    return Findings(
        rows, tables=[_table_of_sets(rows, "", _QUICK_NOTES if scale.quick else _SEED_NOTES)]
    )


TRAINING_SEEDS = Study(
    "training-seeds",
    "The trained placer by training seed",
    1,
    lambda scale: scale.sets(*SETS),
    measure=_compare_seeds,
    brings_tables=True,
)

# Objects, tables and cameras that a placer has not learned from.

CAMERAS = (
    PlacementSet("overhead", HOUSEHOLD.pool, camera="overhead"),
    PlacementSet("side", HOUSEHOLD.pool, camera="side"),
)
_TRANSFER_NOTES = (
    "scored: learned from household alone, on one table, seen by cameras around it, 25 to 65 degrees up; the "
    "sets differ from that in what stands under `new`",
    "scored, all pools: the placer of the package, which learned from household and from all pools together, "
    "on the same table; of dining, kitchen, office and study nothing but the scenes is new to it",
    "overhead: straight down, where nothing hides anything; side: the paper's camera, always in one place",
)


def _compare_transfer(suite: SuiteFolder, sets: Sequence[PlacementSet], stem: Path) -> Findings:
    """Rows on all sets but household as it was learned from."""
    size = suite.scale.pairs(5000)
    rows = []
    runs = suite.train(f"household-scored-{size}", suite.household(), "scored", size)
    placers: dict[str, dict[int, Path] | str] = {
        "scored": runs,
        "geometry-occupied": "geometry-occupied",
    }
    placers |= {f"{name}, all pools": name for name in embedded_placers()}
    for one in sets:
        labels = {"set": one.name, "new": new_parts(one)}
        variants = [Variant(labels | {"placer": name}, each) for name, each in placers.items()]
        rows += rows_of(suite.trials(suite.test_set(one)), variants, suite.scale.noises)
    table = _table_of_sets(rows, f", learned from {size:,} pairs", _TRANSFER_NOTES)
    return Findings(rows, tables=[table])


def new_parts(asked: PlacementSet) -> str:
    """What of a set the placer has not learned from, its scenes aside."""
    fields = {"objects": "pool", "table": "support", "camera": "camera"}
    return ", ".join(
        name for name, field in fields.items() if getattr(asked, field) != getattr(HOUSEHOLD, field)
    )


TRANSFER = Study(
    "transfer",
    "Objects, tables and cameras that a placer has not learned from",
    1,
    lambda scale: scale.sets(*SETS[1:], *CAMERAS),
    measure=_compare_transfer,
    brings_tables=True,
)

# Placers measured as the paper measures, beside what the same proposals are worth.

_PROTOCOL_NOTES = (
    "the paper's protocol: pairs split at random, 80 : 10 : 10, so that pairs to learn from and to test with "
    "are of the same scenes; every object quiet for 20 steps within 60, at 2 deg/s, neighbours may be "
    "pushed; pairs where neither the proposal nor the scene's own pose counts are left out; no noise",
    "strict: the first proposal comes to rest as docs/contract.md asks, disturbs nothing, and then the whole "
    "scene stands",
    "scenes never seen: the queries of the study `placement`, asked of the same placers",
)


def _compare_protocols(suite: SuiteFolder, heads: Sequence[str], stem: Path) -> Findings:
    """Every head, trained and tested on one set's pairs."""
    pairs = suite.household()
    variants = []
    for head in heads:
        name = f"protocol-{head}-{pairs.split('train')['num_pairs']}"
        variants.append(
            Variant({"head": head}, suite.train(name, pairs, head, noise="off", held_out="pairs"))
        )
    variants += [Variant({"head": name}, name) for name in ("random", "geometry-occupied")]
    shared = rows_of(suite.trials(pairs, "train", tenth=TESTING), variants, (0.0,))
    apart = rows_of(suite.trials(suite.test_set()), variants, (0.0,))
    table = protocol_table(group_by_seed(shared), group_by_seed(apart))
    return Findings([*shared, *apart], tables=[table])


def protocol_table(shared: Sequence[list[Row]], apart: Sequence[list[Row]]) -> Table:
    """One line for each head: the same proposals by four counts, then queries of scenes never seen."""
    columns = (
        *("head", "seeds", "paper's protocol", "none left out", "strict"),
        *("strict, scenes never seen", "paper's count, scenes never seen"),
    )
    cells = [
        (
            rows[0]["variant"]["head"],
            "-" if rows[0]["training_seed"] is None else str(len(rows)),
            *(_mean_share(rows, name) for name in ("paper_without_invalid", "paper", "success")),
            *(_mean_share(others, name) for name in ("success", "paper")),
        )
        for rows, others in zip(shared, apart, strict=True)
    ]
    asked = shared[0][0]["trial"]
    others = apart[0][0]["trial"]
    title = f"{asked['queries']} test pairs of the paper's protocol, {others['queries']} of scenes never seen"
    return Table(title, columns, tuple(cells), (*_PROTOCOL_NOTES, SEEDS_NOTE))


def _mean_share(rows: list[Row], name: str) -> str:
    shares = [row["figures"][name] for row in rows]
    mean = shares[0] if len(rows) == 1 else pool_shares(shares, rows[0]["trial"]["queries"])
    return with_interval(mean)


PROTOCOL = Study(
    "protocol",
    "The paper's own protocol, and what it hides",
    1,
    lambda scale: scale.heads_or("scored"),
    measure=_compare_protocols,
    brings_tables=True,
)
