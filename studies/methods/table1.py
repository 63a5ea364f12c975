"""Table 1: success and stable steps of six methods on five pools, and what sets a row apart from the paper's.

The paper: Jia and Chen, "ClutterGen", CoRL 2024. Ten objects on a cuboid table of 0.60 x 0.70 x 0.70 m unless
said otherwise. Success is its looser count: only the current object is judged, the others are put back by
hand. Stable steps are those of all attempts of an object added up.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cluttergen_jax.assets.pool import EMBEDDED
from cluttergen_jax.evaluation.comparison import Column, name_of, request_columns, share, table_of
from cluttergen_jax.evaluation.records import Row
from cluttergen_jax.evaluation.trial import Trial, grid, trial_of
from cluttergen_jax.placement.methods.table import BASELINES
from cluttergen_jax.tables import Table
from studies.cells import LOOSE, STRICT, pooled_success, stable_steps
from studies.results import Result, made_rows
from studies.study import Scale, Study

GROUP_OF_POOL = {
    "dining": ("1, dining", "YCB scans"),
    "study": ("2, studying", "PartNet-Mobility and Objaverse"),
    "office": ("3, office", "PartNet-Mobility and Objaverse"),
    "kitchen": ("4, kitchen", "PartNet-Mobility and Objaverse"),
    "household": ("5, real", "own scans"),
}
"""The paper's group that each embedded pool stands for, and where its objects came from."""

IMPORTED = "paper_"
"""How names of pools begin that were imported from the authors' own files, such as `paper_dining`."""

CLUTTERGEN = "beta_free"
"""The paper's own method."""
TWINS = dict.fromkeys((CLUTTERGEN, "policy"), CLUTTERGEN)
"""Methods that stand where the paper has its own: with its head, and with others."""

OBJECTS = 10
"""Of every scene."""

BUDGET = 2_500_000
"""Environment steps of each training run."""

TABLE_METHODS = ("random", "open_loop", "short_memory", "normal", CLUTTERGEN, "policy")
"""`policy` is ours; the learned ones before it are the paper's method and its rivals."""

ALL_METHODS = (*BASELINES, "guided", *reversed(TABLE_METHODS[1:]))
"""Rows of tables about all methods: those of table 1, and those that the paper does not have."""

_PAPER_POOLS = ("dining", "study", "office", "kitchen", "household")
_PAPER: dict[str, tuple[tuple[float, int], ...]] = {
    "random": ((0.005, 169), (0.0, 290), (0.0, 171), (0.02, 214), (0.005, 176)),
    "open_loop": ((0.212, 139), (0.145, 207), (0.086, 171), (0.232, 165), (0.251, 135)),
    "short_memory": ((0.359, 102), (0.414, 111), (0.364, 107), (0.517, 98), (0.602, 83)),
    "normal": ((0.925, 74), (0.833, 85), (0.951, 56), (0.969, 51), (0.989, 44)),
    CLUTTERGEN: ((0.912, 89), (0.874, 71), (0.963, 60), (0.973, 50), (0.988, 46)),
}
PAPER = {method: dict(zip(_PAPER_POOLS, row, strict=True)) for method, row in _PAPER.items()}
"""The paper's success rate and stable steps by method and pool."""


def papers(method: str, pool: str) -> tuple[float, int] | None:
    """The paper's success and stable steps that a row stands beside; None if there are none.

    Args:
      pool: an embedded one, or the same name after `IMPORTED`.
    """
    return PAPER.get(TWINS.get(method, method), {}).get(pool.removeprefix(IMPORTED))


def trials(scale: Scale) -> tuple[Trial, ...]:
    """Every method on every pool, learned ones for each seed of training."""
    base = scale.trial_by_both_counts(1000, 6)
    pools = scale.pools_or(*EMBEDDED)
    rows = grid(base, pool=pools, method=TABLE_METHODS, training_seed=scale.training_seeds)
    once = (row for row in rows if row.training_seed == 0 or row.method not in BASELINES)
    # `random` also with a height that is drawn.
    heights = {"random": ("free", "rest")}
    return tuple(
        each for row in once for each in grid(row, height=heights.get(row.method, ("rest",)))
    )


def imported_trials(scale: Scale) -> tuple[Trial, ...]:
    """Chance and policies on the paper's own objects, as far as they were imported."""
    base = scale.trial_by_both_counts(1000, 6)
    methods = ("random", "open_loop", CLUTTERGEN, "policy")
    return tuple(
        trial
        for pool, number in scale.imported
        if pool in scale.pools_or(pool)
        for trial in grid(base, pool=(pool,), num_objects=(number,), method=methods)
    )


def first_seed(scale: Scale) -> tuple[Trial, ...]:
    """Those of the first seed of training, which other figures look at more closely, but free heights."""
    return tuple(
        each for each in trials(scale) if each.training_seed == 0 and each.spec.height != "free"
    )


_OF_SEEDS = (
    "success of several seeds: of all their scenes together; the interval is about these policies on other "
    "scenes, and leaves out that another training ends elsewhere (by seed: the strict rate of each)"
)


def tables(result: Result) -> list[Table]:
    """Success and stable steps by pool and method, training seeds taken together."""
    groups = _groups(result["records"])
    # The first row stands for its group.
    made = {id(group[0]): made_rows(group) for group in groups}

    def seeds(row: Row) -> str:
        rows = made[id(row)]
        return "-" if rows and not any(each.get("policy") for each in rows) else str(len(rows))

    def by_seed(row: Row) -> str:
        rates = [share(each["figures"]["success"]) for each in made[id(row)]]
        return " ".join(rates) if len(rates) > 1 else "-"

    columns = (
        *request_columns("pool", "method"),
        Column("seeds", seeds, is_asked=True),
        Column("success, strict [95 %]", lambda row: pooled_success(made[id(row)])),
        Column("by seed", by_seed),
        Column(
            "success, paper's count [95 %]",
            lambda row: pooled_success(made[id(row)], is_loose=True),
        ),
        Column("stable steps", lambda row: stable_steps(made[id(row)])),
        Column("paper: success", lambda row: _papers_cell(row, 0), is_asked=True),
        Column("paper: steps", lambda row: _papers_cell(row, 1), is_asked=True),
        Column("what differs", differs),
    )
    notes = (
        STRICT,
        LOOSE,
        "stable steps: all attempts of a placed object added up, mean ± standard deviation over objects, by "
        "the paper's count, attempts run to step 240",
        "seeds: of training; rows with fewer than were asked for are of those that have a checkpoint",
        *([_OF_SEEDS] if any(len(rows) > 1 for rows in made.values()) else ()),
        *differences(result),
    )
    return [table_of(result["title"], columns, [group[0] for group in groups], notes)]


def _groups(rows: list[Row]) -> list[list[Row]]:
    """The rows of each pool and method that were trained alike; missing ones where none was made."""
    groups: dict[tuple[str, str], dict[Any, list[Row]]] = {}
    for row in rows:
        trainings = groups.setdefault((row["trial"]["pool"], name_of(row)), {})
        attempts = (row.get("policy") or {}).get("attempts")
        trainings.setdefault((differs(row), attempts) if "figures" in row else None, []).append(row)
    alike = []
    for trainings in groups.values():
        missing = trainings.pop(None, [])
        alike += list(trainings.values()) or [missing]
    return alike


def _papers_cell(row: Row, place: int) -> str:
    theirs = papers(row["trial"]["method"], row["trial"]["pool"])
    return (share(theirs[0]), str(theirs[1]))[place] if theirs else "-"


def differs(row: Row) -> str:
    """What sets a row apart from the paper's; `differences` has the words behind it."""
    trial = trial_of(row)
    policy = dict(row.get("policy") or {})
    parts = ["engine", *(["assets"] if trial.pool in GROUP_OF_POOL else [])]
    if trial.num_objects != OBJECTS:
        parts.append(f"{trial.num_objects} objects for {OBJECTS}")
    if trial.method == "random" and trial.spec.height != "free":
        parts.append("height")
    parts += [
        words.format(policy[name])
        for name, (papers, words) in _SETTINGS.items()
        # Results of older versions do not say.
        if policy.get(name) is not None and policy[name] not in papers
    ]
    return ", ".join(parts)


_SETTINGS = {
    "head": ((CLUTTERGEN, "normal"), "head {}"),
    "reward": (("paper",), "reward {}"),
    "discount": ((0.99,), "discount {:g}"),
    "encoder": (("pointnet2 of 20,480 points",), "encoder {}"),
    "height_precision": ((0.0,), "a prior on z"),
    "entropy_cost": ((0.01,), "entropy bonus {:g}"),
    "learning_rate": ((1e-4,), "learning rate {:g}"),
    "is_cut": ((False,), "attempts cut off when they cannot succeed any more"),
}
"""Of how a policy was trained (`ResolvedTrial.policy`): the paper's values, and what is said of others."""


def differences(result: Result) -> tuple[str, ...]:
    """Notes below a table with a column of `differs`."""
    pools = dict.fromkeys(row["trial"]["pool"] for row in result["records"])
    groups = [(pool, *GROUP_OF_POOL[pool]) for pool in pools if pool in GROUP_OF_POOL]
    # Rows that an older version kept do not say where they were made.
    version = f" {result['machine']['versions']['mujoco']}" if result["machine"] else ""
    engine = f"engine: MuJoCo{version} for PyBullet"
    stands = "; ".join(f"{pool} for group {group} ({assets})" for pool, group, assets in groups)
    return (
        f"what differs from the paper: {engine}; its policies had {BUDGET:,} training attempts",
        *([f"assets: modelled objects, {stands}"] if groups else []),
        "height: `random` lets go at the object's own resting height",
        *([_FREE] if any(trial_of(row).spec.height == "free" for row in result["records"]) else ()),
        *([_NOT_NOTED] if any(_is_not_noted(row) for row in result["records"]) else ()),
    )


_FREE = (
    "free height: it lets go anywhere up to the tallest object's height and its own, as the paper's may: "
    "mostly inside what stands there or so far above the top that it is not at rest in time"
)

_NOT_NOTED = (
    "learned rows that name neither reward nor encoder were kept by an older version, which did not note "
    "them, nor discount and prior: they are of preset `cpu`, as those with reward compressed and discount 0.9"
)


def _is_not_noted(row: Row) -> bool:
    policy = row.get("policy") or {}
    return policy.get("preset") == "cpu" and "reward" not in policy


TABLE1 = Study(
    "table1",
    "Success and stable steps by method and pool (table 1)",
    1000,
    trials,
    make_tables=tables,
)
IMPORTED_GROUPS = replace(
    TABLE1, name="imported", title="The same with the paper's own objects", trials=imported_trials
)
