"""Training runs side by side: how soon they were good, and how good they ended.

python -m studies.benchmarks.trained runs/dining-policy-0 runs/dining-policy-1 runs/dining-policy-2 --write
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training.run_logger import read_rows
from cluttergen_jax.learning.training.suite import DEFAULT_ATTEMPTS, DEFAULT_OBJECTS
from studies.benchmarks.section import prose, report, table

GOAL = 0.95
WINDOW = 10
DEFAULT_PRESET = "cpu"


def first_good(success: np.ndarray) -> int | None:
    """The first update at which the mean success over WINDOW updates reaches GOAL; None if none does."""
    smooth = np.convolve(success, np.ones(WINDOW) / WINDOW, mode="valid")
    reached = np.flatnonzero(smooth >= GOAL)
    return int(reached[0]) + WINDOW - 1 if len(reached) else None


def name_of(record: dict) -> str:
    """What a run trained, in a few words; what is as usual is left out."""
    objects, attempts = (record["placement"][name] for name in ("num_objects", "max_attempts"))
    words = [record["pool"], record["support"], record["variant"], f"seed {record['seed']}"]
    preset = record.get("preset", DEFAULT_PRESET)
    words += [f"preset {preset}"] if preset != DEFAULT_PRESET else []
    words += [f"{objects} objects"] if objects != DEFAULT_OBJECTS else []
    words += [f"{attempts} attempts"] if attempts != DEFAULT_ATTEMPTS else []
    words += [f"changed regions ({record['change']})"] if "change" in record else []
    return ", ".join(words)


def success_of(record: dict) -> str:
    """Success of the last evaluation with its interval; a dash where the run was not evaluated."""
    found = record.get("evaluation")
    return f"{found['success']:.3f} [{found['low95']:.3f}, {found['high95']:.3f}]" if found else "-"


def cells(run: Path) -> list[str]:
    """A run's row of the table."""
    rows = read_rows(run / "progress.csv")
    record = read_record(run / "policy")
    size = rows[0]["attempts"]
    minutes = np.cumsum([size / row["attempts_per_second"] for row in rows]) / 60
    good = first_good(np.array([row["success"] for row in rows]))
    soon = (
        ("not reached", "")
        if good is None
        else (f"{rows[good]['attempts']:,.0f}", f"{minutes[good]:.1f}")
    )
    return [
        name_of(record),
        *soon,
        f"{rows[-1]['attempts']:,.0f}",
        f"{minutes[-1]:.1f}",
        success_of(record),
    ]


def main() -> None:
    """Writes the section."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument(
        "--write", action="store_true", help="put the section into reports/benchmarks.md"
    )
    args = parser.parse_args()
    body = prose(
        f"""Preset `{DEFAULT_PRESET}`, {DEFAULT_OBJECTS} objects and up to {DEFAULT_ATTEMPTS} attempts each
        unless said. Soon: when the training's success over {WINDOW} updates first reached {GOAL}. Minutes are
        of training, compilation (about one) not counted; the runs shared two cores with each other and with
        other work, so they are upper bounds and not to be compared. Success: of 256 fresh episodes with the
        whole last check, actions sampled, 95 % interval."""
    )
    header = ["run", "attempts to 0.95", "minutes to 0.95", "attempts", "minutes", "success"]
    lines = table(header, [cells(run) for run in args.runs])
    report("trained", f"## Trained policies\n\n{body}\n\n{lines}", write=args.write)


if __name__ == "__main__":
    main()
