"""One trial in a process of its own, timed from its first import to its last scene.

python -m studies.timing ORDER      ORDER is JSON: see `main`
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any


def main(text: str) -> dict[str, Any]:
    """Runs the trial of an order: `trial` (its fields), `cores`, `engine`, `checkpoint` (folder or null).

    Returns:
      Cores used, valid scenes, and wall seconds per valid scene: whole, with imports and compilation, and in
      the long run, without. Rejected work is included in both.
    """
    started = time.perf_counter()
    order = json.loads(text)
    if hasattr(os, "sched_setaffinity"):
        # Before the imports, since threads keep the cores that they were born with.
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: order["cores"]])
    from cluttergen_jax.evaluation.resolved import Checkpoints
    from cluttergen_jax.evaluation.runner import Runner
    from cluttergen_jax.evaluation.store import Store
    from cluttergen_jax.evaluation.trial import trial_of

    checkpoint = order["checkpoint"] and Path(order["checkpoint"])
    runner = Runner(Store(None), Checkpoints(path=checkpoint), order["engine"], order["cores"])
    outcome = runner.run(runner.resolve(trial_of(order)))
    valid = int(outcome.scenes.is_success.sum())
    whole = time.perf_counter() - started
    return {
        "cores": order["cores"],
        "scenes": len(outcome.scenes.is_success),
        "valid": valid,
        "seconds": whole,
        "seconds_per_valid_scene": whole / valid if valid else None,
        "running_seconds_per_valid_scene": outcome.seconds / valid if valid else None,
    }


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1])))
