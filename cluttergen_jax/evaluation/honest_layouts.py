"""Tables of the studies that the paper does not have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cluttergen_jax.evaluation.plots import rung_of
from cluttergen_jax.evaluation.tables import Table, interval, missing, number, share
from cluttergen_jax.placement.config import MIN_MARGIN

Result = dict[str, Any]
_HEAD = ("pool", "table", "method")


def density(result: Result) -> list[Table]:
    """Success and cost along the density ladder."""
    columns = (
        "pool",
        "rung",
        "method",
        "success [95 %]",
        "objects placed",
        "attempts per valid scene",
        "simulated steps per valid scene",
        "valid scenes per CPU-second",
    )
    rows, lacking = [], []
    for record in result["records"]:
        trial = record["trial"]
        if "figures" not in record:
            lacking.append(record)
            continue
        head = (trial["pool"], rung_of(trial), trial["method"])
        figures = record["figures"]
        rows.append(
            (
                *head,
                interval(figures["success"], figures["low95"], figures["high95"]),
                number(figures["placed"], 2),
                number(figures["attempts_per_valid_scene"]) if figures["num_success"] else "-",
                number(figures["simulated_steps_per_valid_scene"], 0) if figures["num_success"] else "-",
                number(figures["valid_scenes_per_cpu_second"], 1),
            )
        )
    notes = (
        "the same attempts for all (five an object), cut off as soon as they can no longer succeed; what "
        "overhangs "
        "can fall",
        "per valid scene: all attempts and steps of the row, rejected scenes included; speeds leave "
        "compilation out",
        *dict.fromkeys(map(missing, lacking)),
    )
    return [Table(result["title"], columns, tuple(rows), notes)]


def diversity(result: Result) -> list[Table]:
    """How different scenes are."""
    columns = (*_HEAD, "scenes", "evenness", "nearest scene, m", "Vendi score", "bounding box, m^2")
    rows = _rows(
        result,
        columns,
        lambda row: (
            str(row["scenes"]),
            number(row["evenness"], 3),
            number(row["nearest"], 3),
            number(row["vendi"], 1),
            number(row["box_area"], 3),
        ),
    )
    notes = (
        "evenness: entropy of an object's position over 5 cm cells, 1 for an even spread, mean over objects",
        "nearest scene: distance to the most similar other scene; Vendi score: effective number of "
        "different scenes",
        "bounding box: the paper's measure, decided by outliers",
    )
    return [Table(result["title"], columns, rows, notes)]


def acceptance(result: Result) -> list[Table]:
    """What is under-represented among what passes."""
    columns = (*_HEAD, "sorted by", "proposals", "passed", "under-represented: lift [95 %]")
    rows = _rows(
        result,
        columns,
        lambda row: (
            row["sorting"],
            str(row["proposals"]),
            str(row["passed"]),
            "; ".join(f"{each['label']} {_lift(each)}" for each in row["under"][:5]) or "nothing",
        ),
    )
    notes = (
        "lift: share among proposals that stand in a valid scene over share among all proposals; 1 is no "
        "bias",
        "shown are at most five whose whole interval lies below 1; intervals are bootstrapped over scenes",
    )
    return [Table(result["title"], columns, rows, notes)]


def _lift(row: dict) -> str:
    return f"{row['lift']:.2f} [{row['low95']:.2f}, {row['high95']:.2f}]"


def robustness(result: Result) -> list[Table]:
    """Creep and shake, then changed physics."""
    made = [row for row in result["measure"]["rows"] if "creep" in row]
    seconds = [each["seconds"] for each in made[0]["creep"]] if made else []
    changes = list(made[0]["changes"]) if made else []
    stands = [f"stands {each:g} s" for each in seconds]
    creep = [f"median creep {each:g} s, micrometres" for each in seconds]
    columns = (*_HEAD, "scenes", *stands, *creep, "shake, m/s^2")
    first = _rows(
        result,
        columns,
        lambda row: (
            str(row["scenes"]),
            *(share(each["share"]) for each in row["creep"]),
            *(number(_scaled(each["median_shift"], 1e6), 2) for each in row["creep"]),
            f"{row['shake'][1]:.2f} [{row['shake'][0]:.2f}, {row['shake'][2]:.2f}]",
        ),
    )
    other = (*_HEAD, *changes)
    second = _rows(result, other, lambda row: tuple(share(row["changes"][name]["share"]) for name in changes))
    notes = (
        "stands: nothing moved over 5 mm or turned over 5 degrees; creep: the largest movement in a scene",
        "shake: sideways acceleration of the table at which something has moved 5 mm, the weaker of two "
        "directions, "
        "median [10 %, 90 %] of scenes",
    )
    return [
        Table(result["title"], columns, first, notes),
        Table("Share of scenes that stand 10 s under changed physics", other, second, (notes[0],)),
    ]


def survival(result: Result) -> list[Table]:
    """Scenes in other engines."""
    # Only studies that ask for margins name them.
    asks = any("min_margin" in row for row in result["measure"]["rows"])
    asked = ("margin asked for, mm",) if asks else ()
    columns = (*_HEAD, *asked, "engine", "scenes", "stands 10 s [95 %]", "median of the largest movement, mm")
    rows = _rows(
        result,
        columns,
        lambda row: (
            *(number(_scaled(row.get("min_margin", 0.0), 1e3), 0) for _ in asked),
            row["engine"],
            str(row["scenes"]),
            interval(row["share"], row["low95"], row["high95"]),
            number(_scaled(row["median_shift"], 1e3), 2),
        ),
    )
    notes = (
        "stands: nothing moved over 5 mm or turned over 5 degrees",
        "`policy` on 0.40 x 0.50 m: it puts centres of mass within 3 mm of the table's edge, and what "
        "balances there tips in another engine; with a support margin asked for, "
        "more of its scenes stand in both",
    )
    return [Table(result["title"], columns, rows, notes)]


def margin(result: Result) -> list[Table]:
    """Support margins, and tilted gravity."""
    made = [row for row in result["measure"]["rows"] if "tilt" in row]
    angles = made[0]["tilt"] if made else []
    columns = (
        *_HEAD,
        "margin asked for, mm",
        "success [95 %]",
        "attempts unsupported",
        "scenes",
        "least margin of a scene, mm",
        f"scenes below {1e3 * MIN_MARGIN:g} mm",
        *(f"stand tilted {each['degrees']:g} deg" for each in angles),
    )
    rows = _rows(
        result,
        columns,
        lambda row: (
            number(_scaled(row.get("min_margin", 0.0), 1e3), 0),
            interval(row["success"], row["low95"], row["high95"]),
            share(row["unsupported"]),
            str(row["scenes"]),
            f"{1e3 * row['margin'][2]:.1f} [{1e3 * row['margin'][0]:.1f}, {1e3 * row['margin'][1]:.1f}]",
            share(row["below"]),
            *(f"{share(each['share'])} ({share(each['directions'])})" for each in row["tilt"]),
        ),
    )
    notes = (
        "support margin: distance in plan of an object's centre of mass to the edge of the polygon of the "
        "contacts that carry it; of the object of a scene that has least: median [least, 10 %] of scenes",
        "stand tilted: share of scenes in which nothing moves over 5 mm or turns over 5 degrees within 2 s, "
        "in whichever of eight directions gravity is tilted; in brackets, of scenes and directions",
    )
    return [Table(result["title"], columns, rows, notes)]


def timing(result: Result) -> list[Table]:
    """Seconds per scene."""
    columns = (
        "pool",
        "method",
        "cores",
        "valid scenes",
        "whole process, s",
        "s per valid scene",
        "without start, s",
    )
    rows = []
    for row in result["measure"]["rows"]:
        if "missing" in row:
            rows.append((row["pool"], row["method"], "-", missing(row), "-", "-", "-"))
            continue
        rows.append(
            (
                row["pool"],
                row["method"],
                str(row["cores"]),
                f"{row['valid']} of {row['scenes']}",
                number(row["seconds"]),
                number(row["seconds_per_valid_scene"], 4),
                number(row["running_seconds_per_valid_scene"], 4),
            )
        )
    notes = (
        "wall time of a process of its own, from its first import to its last scene; the last column "
        "leaves out imports, "
        "models and compilation; rejected work is included in both",
    )
    return [Table(result["title"], columns, tuple(rows), notes)]


def _scaled(metres: float | None, factor: float) -> float | None:
    return None if metres is None else factor * metres


def _rows(
    result: Result, columns: tuple[str, ...], cells: Callable[[dict], tuple[str, ...]]
) -> tuple[tuple[str, ...], ...]:
    """The measure's rows, each after pool, table and method; what is missing takes the first cell."""
    rows = []
    for row in result["measure"]["rows"]:
        head = (row["pool"], row["support"], row["method"])
        blank = (missing(row), *["-"] * (len(columns) - len(head) - 1)) if "missing" in row else None
        rows.append((*head, *(blank or cells(row))))
    return tuple(rows)


HONEST_LAYOUTS = {
    "density": density,
    "diversity": diversity,
    "acceptance": acceptance,
    "robustness": robustness,
    "survival": survival,
    "margin": margin,
    "time": timing,
}
