"""What a bank amounts to, in a few lines."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from cluttergen_jax.bank.table import COUNTED
from cluttergen_jax.types import Verdict


def summary_of(table: pa.Table, num_scenes: int, num_new: int = 0, seconds: float = 0.0) -> str:
    """Success, attempts, steps to rest and rejections by verdict of the first `num_scenes` rows.

    Args:
      num_new, seconds: scenes made just now and how long that took, for the rate; 0 leaves it out.
    """
    rows = table.slice(0, num_scenes)
    success = np.array(rows["is_success"])
    filled = np.array(rows["is_filled"])
    attempts = np.concatenate([np.array(each) for each in rows["attempts"].to_pylist()])
    steps = np.concatenate([np.array(each) for each in rows["rest_steps"].to_pylist()])
    placed = np.concatenate([np.array(each, bool) for each in rows["is_placed"].to_pylist()])
    # Objects that stood there at the beginning took no attempt.
    placed &= attempts > 0
    mean_attempts = attempts[placed].mean() if placed.any() else 0.0
    mean_steps = steps[placed].mean() if placed.any() else 0.0
    counts = {v: int(np.sum(rows[f"num_{v.label.replace('-', '_')}"])) for v in COUNTED}
    total = max(sum(counts.values()), 1)
    lines = [
        f"scenes     {len(success)}, of which {success.sum()} succeed ({success.mean():.1%}): "
        "every object placed, and all stand together in the last check",
        f"filled     {filled.sum()} ({filled.mean():.1%}) before the last check",
        f"attempts   {attempts.sum()}, {mean_attempts:.2f} per placed object",
        f"rest       after {mean_steps:.0f} steps of 1/240 s in the mean",
    ]
    rejected = [
        f"{number} {verdict.label} ({number / total:.1%}): {verdict.sentence}"
        for verdict, number in counts.items()
        if number and verdict != Verdict.STABLE
    ]
    lines.append("rejected   " + ("\n           ".join(rejected) or "nothing"))
    if num_new and seconds > 0:
        lines.append(f"speed      {num_new} new scenes in {seconds:.1f} s, compilation included")
    return "\n".join(lines)
