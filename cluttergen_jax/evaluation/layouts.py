"""Tables of a study's result: which figures stand where, and the paper's beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from cluttergen_jax.evaluation import published
from cluttergen_jax.evaluation.honest_layouts import HONEST_LAYOUTS
from cluttergen_jax.evaluation.plots import at_least
from cluttergen_jax.evaluation.proportion import wilson
from cluttergen_jax.evaluation.tables import Table, interval, mean_and_spread, missing, number, share

Result = dict[str, Any]
Layout = Callable[[Result], list[Table]]
_STRICT = "strict: every slot stable without disturbing anything, and the finished scene stands"
_LOOSE = "paper's count: only the object in hand is judged, the others are put back, no last check"


def table1(result: Result) -> list[Table]:
    """Success and stable steps by pool and method, training seeds taken together."""
    columns = (
        "pool",
        "method",
        "seeds",
        "success, strict [95 %]",
        "by seed",
        "success, paper's count [95 %]",
        "stable steps",
        "paper: success",
        "paper: steps",
        "what differs",
    )
    rows = []
    for (pool, method), records in _grouped(result, "pool", "method").items():
        made = [record for record in records if "figures" in record]
        theirs = published.table_1(method, pool)
        paper = (share(theirs[0]), str(theirs[1])) if theirs else ("-", "-")
        if not made:
            rows.append((pool, method, "0", missing(records[0]), "-", "-", "-", *paper, "-"))
            continue
        strict, loose = (_pooled(made, source) for source in (None, "paper"))
        seeds = [share(record["figures"]["success"]) for record in made]
        rows.append(
            (
                pool,
                method,
                str(len(made)) if _is_learned(made) else "-",
                strict,
                " ".join(seeds) if len(seeds) > 1 else "-",
                loose,
                _steps(made),
                *paper,
                differs(pool, method, made[0]),
            )
        )
    notes = (
        _STRICT,
        _LOOSE,
        "stable steps: all attempts of a placed object added up, mean ± standard deviation over objects, "
        "by the "
        "paper's count, attempts run to step 240",
        "seeds: of training; rows with fewer than were asked for are of those that have a checkpoint",
        *_differences(result),
    )
    return [Table(result["title"], columns, tuple(rows), notes)]


def differs(pool: str, method: str, record: dict) -> str:
    """What sets a row apart from the paper's; `_differences` has the words behind it."""
    parts = ["engine", *(["assets"] if pool in published.GROUP_OF_POOL else [])]
    if record["trial"]["num_objects"] != published.OBJECTS:
        parts.append(f"{record['trial']['num_objects']} objects for {published.OBJECTS}")
    if method == "random":
        parts.append("height")
    policy = record.get("policy") or {}
    if policy.get("head") not in (None, "beta", "normal"):
        parts.append(f"head: {policy['head']}")
    if policy.get("attempts"):
        parts.append(f"{policy['attempts']:,} training attempts")
    return ", ".join(parts)


def _differences(result: Result) -> tuple[str, ...]:
    """Notes below a table with a column of `differs`."""
    pools = dict.fromkeys(record["trial"]["pool"] for record in result["records"])
    groups = [(pool, *published.GROUP_OF_POOL[pool]) for pool in pools if pool in published.GROUP_OF_POOL]
    engine = f"engine: MuJoCo {result['machine']['versions']['mujoco']} for PyBullet"
    stands = "; ".join(f"{pool} for group {group} ({assets})" for pool, group, assets in groups)
    return (
        f"what differs from the paper: {engine}; its policies had {published.BUDGET:,} training attempts",
        *([f"assets: modelled objects, {stands}"] if groups else []),
        "height: `random` lets go at the object's own resting height",
    )


def fig1a(result: Result) -> list[Table]:
    """Success against the number of objects."""
    made = [record for record in result["records"] if "figures" in record]
    most = max((len(record["figures"]["placed_histogram"]) - 1 for record in made), default=0)
    rows = []
    for record in result["records"]:
        trial = record["trial"]
        head = (trial["pool"], trial["method"])
        if "figures" not in record:
            rows.append((*head, missing(record), *["-"] * (most - 1 if most else 0)))
            continue
        shares = at_least(record["figures"]["paper"]["placed_histogram"])
        rows.append((*head, *(share(each) for each in shares)))
    columns = ("pool", "method", *(f"n = {n}" for n in range(1, max(most, 1) + 1)))
    notes = (
        _LOOSE,
        "an episode of n objects is the beginning of one of ten: orders are uniform, and no method is told "
        "how many "
        "are to come",
        "the dotted lines of the plot are strict but for the last check; the paper gives its figure "
        "without numbers",
    )
    return [Table(result["title"], columns, tuple(rows), notes)]


def steps_by_attempt(result: Result) -> list[Table]:
    """Mean steps of the first attempt, the second, and so on."""
    rows = []
    for record in result["records"]:
        trial = record["trial"]
        head = (trial["pool"], trial["method"])
        if "figures" not in record:
            rows.append((*head, missing(record), *["-"] * trial["attempts"]))
            continue
        steps = {each["attempt"]: each for each in record["figures"]["paper"]["steps_by_attempt"]}
        cells = [mean_and_spread(steps[a]) if a in steps else "-" for a in range(1, trial["attempts"] + 1)]
        rows.append((*head, str(steps[1]["count"] if 1 in steps else 0), *cells))
    most = max((record["trial"]["attempts"] for record in result["records"]), default=0)
    columns = ("pool", "method", "placements", *(f"attempt {a}" for a in range(1, most + 1)))
    notes = (
        _LOOSE,
        "objects that stood in the end and took at least three attempts; mean ± standard deviation",
    )
    return [Table(result["title"], columns, tuple(rows), notes)]


def attempts(result: Result) -> list[Table]:
    """Success against the attempts allowed."""
    columns = (
        "pool",
        "method",
        "attempts",
        "trained with",
        "success, strict [95 %]",
        "success, paper's count [95 %]",
        "stable steps",
    )
    rows = [
        (
            *_head(record, "pool", "method", "attempts"),
            str((record.get("policy") or {}).get("max_attempts", "-")),
            *_both(record),
            _steps([record]) if "figures" in record else "-",
        )
        for record in result["records"]
    ]
    note = f"the paper: {published.ATTEMPTS_SENTENCE} (a figure without numbers)"
    return [Table(result["title"], columns, tuple(rows), (_STRICT, _LOOSE, note))]


def table2(result: Result) -> list[Table]:
    """Success under changes of the region."""
    columns = (
        "pool",
        "method",
        "change",
        "success, strict [95 %]",
        "success, paper's count [95 %]",
        "paper: success",
        "what differs",
    )
    rows = []
    for record in result["records"]:
        trial = record["trial"]
        head = _head(record, "pool", "method", "change")
        paper = share(published.TABLE_2[trial["change"]]) if trial["method"] in published.TWINS else "-"
        note = differs(trial["pool"], trial["method"], record) if "figures" in record else "-"
        rows.append((*head, *_both(record), paper, note))
    notes = (
        _STRICT,
        _LOOSE,
        "table of 1.40 x 1.40 m, region of 0.60 x 0.70 m at its middle; each episode draws its own change: "
        "translation "
        "up to 15 cm in x and y, rotation up to half a turn to either side, half extents up to 10 cm "
        "smaller or larger",
        "a drawn region is kept on the table: moved inwards by as little as it takes",
        *_differences(result),
    )
    return [Table(result["title"], columns, tuple(rows), notes)]


def furniture(result: Result) -> list[Table]:
    """Success by table and pool, a table for each method and count."""
    methods = dict.fromkeys(record["trial"]["method"] for record in result["records"])
    return [table for method in methods for table in _furniture_of(result, method)]


def _furniture_of(result: Result, method: str) -> list[Table]:
    result = result | {"records": [r for r in result["records"] if r["trial"]["method"] == method]}
    pools = list(dict.fromkeys(record["trial"]["pool"] for record in result["records"]))
    counts: list[tuple[str, str | None]] = [("strict", None)]
    if any("paper" in record.get("figures", {}) for record in result["records"]):
        counts.append(("paper's count", "paper"))
    return [_furniture(result, pools, f"{method}, {name}", source) for name, source in counts]


def _furniture(result: Result, pools: list[str], name: str, source: str | None) -> Table:
    cells = {(r["trial"]["support"], r["trial"]["pool"]): r for r in result["records"]}
    rows = []
    for support in dict.fromkeys(key[0] for key in cells):
        row = [cells.get((support, pool)) for pool in pools]
        rows.append((support, *(_rate(record, source) for record in row), _total(row, source)))
    columns_of = [[r for (_, p), r in cells.items() if p == pool] for pool in pools]
    everything = _total(cells.values(), source)
    rows.append(("all", *(_total(column, source) for column in columns_of), everything))
    lacking = sorted({record["hint"] for record in cells.values() if "hint" in record})
    notes = [
        _LOOSE if source else _STRICT,
        f"the paper: {share(published.FURNITURE)} over ten furniture tables and all groups, by its own count",
        "the region is the support's own, changed at random in every episode (as `all` in table 2), then "
        "moved and shrunk, by as little area as it takes, until it lies within the support's own again: on a "
        "narrow table a turned one is much smaller than the 0.60 x 0.70 m of training",
        "the tables are this project's",
        *(f"no checkpoint: {hint}" for hint in lacking),
    ]
    return Table(f"{result['title']} ({name})", ("table", *pools, "all pools"), tuple(rows), tuple(notes))


def diversity_maps(result: Result) -> list[Table]:
    """Bounding boxes and evenness of each object's positions."""
    measured = result["measure"]["rows"]
    columns = ("pool", "method", "object", "scenes", "bounding box, m^2", "evenness")
    rows = tuple(
        (row["pool"], row["method"], "-", missing(row), "-", "-")
        if "missing" in row
        else (
            row["pool"],
            row["method"],
            row["object"],
            str(row["scenes"]),
            number(row["box_area"], 3),
            number(row["evenness"], 3),
        )
        for row in measured
    )
    notes = (
        "bounding box: the paper's measure, decided by outliers; evenness: entropy over 5 cm cells, 1 for "
        "an even "
        "spread; the picture shows at most 500 scenes",
    )
    return [Table(result["title"], columns, rows, notes)]


def learning_curves(result: Result) -> list[Table]:
    """Where training ended."""
    rows = tuple(
        (
            row["pool"],
            row["method"],
            str(row["seed"]),
            f"{row['attempts']:,}",
            share(row["success"]),
            share(row["checked"]),
        )
        for row in result["measure"]["rows"]
    )
    theirs = f"{published.LEARNING_SUCCESS} after {published.LEARNING_ATTEMPTS:,} attempts"
    note = f"the paper: above {theirs} in every group"
    columns = (
        "pool",
        "method",
        "seed",
        "training attempts",
        "success at the end, while training",
        "by the last check",
    )
    return [Table(result["title"], columns, rows, (note,))]


def relations(result: Result) -> list[Table]:
    """Relations per hundred scenes, and the commonest pairs."""
    columns = ("pool", "method", "relation", "per 100 scenes", "scenes with one", "commonest")
    rows = []
    for row in result["measure"]["rows"]:
        if "missing" in row:
            rows.append((row["pool"], row["method"], "-", missing(row), "-", "-"))
            continue
        common = "; ".join(f"{each['what']} ({each['count']})" for each in row["commonest"])
        rows.append(
            (
                row["pool"],
                row["method"],
                row["relation"],
                number(100 * row["count"] / row["scenes"]),
                f"{row['scenes_with']} of {row['scenes']}",
                common or "-",
            )
        )
    return [
        Table(
            result["title"],
            columns,
            tuple(rows),
            ("between objects, counted from contacts, in valid scenes",),
        )
    ]


def closed_loop(result: Result) -> list[Table]:
    """A picture alone."""
    return []


def _grouped(result: Result, *names: str) -> dict[tuple, list[dict]]:
    groups: dict[tuple, list[dict]] = {}
    for record in result["records"]:
        groups.setdefault(tuple(record["trial"][name] for name in names), []).append(record)
    return groups


def _head(record: dict, *names: str) -> tuple[str, ...]:
    return tuple(str(record["trial"][name]) for name in names)


def _is_learned(records: list[dict]) -> bool:
    return any(record.get("policy") for record in records)


def _figures(record: dict, source: str | None) -> dict:
    return record["figures"] if source is None else record["figures"][source]


def _pooled(records: Iterable[dict], source: str | None) -> str:
    """Success over all trials of several records, with its interval."""
    figures = [_figures(record, source) for record in records]
    successes, trials = (sum(each[name] for each in figures) for name in ("num_success", "trials"))
    return interval(successes / trials, *wilson(successes, trials))


def _both(record: dict) -> tuple[str, str]:
    if "figures" not in record:
        return missing(record), "-"
    return _pooled([record], None), _pooled([record], "paper")


def _steps(records: list[dict]) -> str:
    """Stable steps by the paper's count; of several seeds, their plain mean."""
    spreads = [record["figures"]["paper"]["stable_steps"] for record in records]
    known = [each for each in spreads if each["mean"] is not None]
    if not known:
        return "-"
    mean, std = (sum(each[name] for each in known) / len(known) for name in ("mean", "std"))
    return mean_and_spread({"mean": mean, "std": std})


def _rate(record: dict | None, source: str | None) -> str:
    if record is None or "figures" not in record:
        return "-"
    return share(_figures(record, source)["success"])


def _total(records: Iterable[dict | None], source: str | None) -> str:
    made = [record for record in records if record is not None and "figures" in record]
    return _pooled(made, source) if made else "-"


LAYOUTS: dict[str, Layout] = {
    "table1": table1,
    "fig1a": fig1a,
    "steps_by_attempt": steps_by_attempt,
    "attempts": attempts,
    "table2": table2,
    "furniture": furniture,
    "diversity_maps": diversity_maps,
    "closed_loop": closed_loop,
    "learning_curves": learning_curves,
    "relations": relations,
    **HONEST_LAYOUTS,
}
