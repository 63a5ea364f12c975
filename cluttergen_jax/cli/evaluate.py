"""`cluttergen evaluate`: methods side by side, the same problem and the same budget of attempts for all."""

from __future__ import annotations

import csv
import io
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.bank.disk import write_atomically
from cluttergen_jax.baselines import METHODS as BASELINES
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.methods import checkpoint_of, proposer_of, suited
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.problem import ProblemConfig, make_problem
from cluttergen_jax.sampling import BlockSampler, blocks_of, sample_blocks

_Z95 = 1.959964


@dataclass(frozen=True)
class Evaluate:
    """Compare methods on pools and supports. Writes table.md, table.csv and results.json.

    Attributes:
      methods: random, clear, drop, and trained policies: policy, open_loop, short_memory, normal.
      checkpoint: the policy's folder, for a single learned method; else the embedded ones are taken.
      pools: names or folders.
      supports: names or folders; table-0.40x0.50 is a cuboid of that size, all of it the queried region.
      num_objects: objects per scene.
      trials: scenes per row.
      seed: of the scenes.
      attempts: per object.
      repeat: let objects stand there more than once.
      out: where the tables go.
    """

    methods: tuple[str, ...] = ("random", "clear", "drop")
    checkpoint: str | None = None
    pools: tuple[str, ...] = ("dining",)
    supports: tuple[str, ...] = ("table",)
    num_objects: int = 10
    trials: int = 1000
    seed: int = 0
    attempts: int = 5
    repeat: bool = False
    out: str = "out/evaluation"

    def run(self) -> int:
        """Runs the command; the exit status."""
        if not 1 <= self.trials <= 1_000_000:
            raise ConfigError(f"--trials {self.trials}", "1 to 1000000")
        for pool in self.pools:
            find_pool(pool)
        rows = [
            row_of(self, pool, support, method)
            for pool in self.pools
            for support in self.supports
            for method in self.methods
        ]
        print(markdown(rows))
        out = Path(self.out)
        write_atomically(out / "table.md", (markdown(rows) + "\n").encode())
        write_atomically(out / "table.csv", csv_text(rows).encode())
        write_atomically(out / "results.json", (json.dumps(rows, indent=1) + "\n").encode())
        return 0


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % interval of a proportion (Wilson, 1927)."""
    rate, z2 = successes / trials, _Z95**2
    centre = rate + z2 / (2 * trials)
    half = _Z95 * math.sqrt(rate * (1 - rate) / trials + z2 / (4 * trials**2))
    return (centre - half) / (1 + z2 / trials), (centre + half) / (1 + z2 / trials)


def row_of(args: Evaluate, pool: str, support: str, method: str) -> dict[str, Any]:
    """One row: `args.trials` scenes of one method on one pool and support."""
    checkpoint = checkpoint_of(method, pool, args.checkpoint if method not in BASELINES else None)
    placement = suited(PlacementConfig(num_objects=args.num_objects, max_attempts=args.attempts), checkpoint)
    problem = make_problem(ProblemConfig(pool=pool, support=support, repeat=args.repeat, placement=placement))
    sampler = BlockSampler(problem.rules, proposer_of(method, checkpoint, problem.rules))
    started, cpu = time.perf_counter(), time.process_time()
    title = f"{method} {support}"
    done = [scenes for _, _, scenes in sample_blocks(sampler, blocks_of(args.trials), args.seed, title)]
    success = np.concatenate([scenes.is_success for scenes in done])
    placed = np.concatenate([scenes.is_placed for scenes in done])
    attempts = np.concatenate([scenes.counts.attempts for scenes in done])
    simulated = np.concatenate([scenes.counts.simulated_steps for scenes in done])
    low, high = wilson(int(success.sum()), len(success))
    valid = max(int(success.sum()), 1)
    return {
        "pool": pool,
        "support": support,
        "objects": args.num_objects,
        "method": method,
        "trials": len(success),
        "success": float(success.mean()),
        "low95": low,
        "high95": high,
        "filled": float(np.mean(np.concatenate([scenes.is_filled for scenes in done]))),
        "placed": float(placed.sum(1).mean()),
        "attempts_per_valid_scene": float(attempts.sum() / valid),
        "simulated_steps_per_valid_scene": float(simulated.sum() / valid),
        "valid_scenes_per_cpu_second": float(success.sum() / (time.process_time() - cpu)),
        "seconds": time.perf_counter() - started,
    }


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table for people; speeds include compilation."""
    lines = [
        "| pool | support | objects | method | success [95 %] | filled | placed "
        "| attempts per valid scene | valid scenes per CPU-second |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(
            f"| {row['pool']} | {row['support']} | {row['objects']} | {row['method']} "
            f"| {row['success']:.3f} [{row['low95']:.3f}, {row['high95']:.3f}] | {row['filled']:.3f} "
            f"| {row['placed']:.2f} | {row['attempts_per_valid_scene']:.1f} "
            f"| {row['valid_scenes_per_cpu_second']:.1f} |"
        )
    return "\n".join(lines)


def csv_text(rows: list[dict[str, Any]]) -> str:
    """The same with all digits."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
