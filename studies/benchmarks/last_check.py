"""The staged last check against the full one: where do they disagree, and what does each cost?

Scenes are filled by the baselines and handed to the last check whatever it may say: staged (60 steps; hardly
moved: it stands; else 480 steps) and full (480 steps for all). Some are watched for ten seconds as well:
those that moved most by the end of the full check, and others at random.

    python -m studies.benchmarks.last_check [--num-scenes N] [--write]
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import tyro

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.physics.layout import Layout
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.types import Verdict
from studies.benchmarks.sampled import make_block_sampler, placed_poses
from studies.benchmarks.section import prose, report, table

_VERIFY_STEPS = 2400
_THRESHOLDS_MM = (0.0001, 0.001, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
_LIMITS_MM = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True)
class LastCheck:
    """Compare the staged last check with the full one.

    Attributes:
      pool: name or folder.
      support: tables; the tight ones make scenes that lean and overlap.
      method: who fills them.
      num_scenes: scenes begun for each support and method; those that are filled count.
      num_verified: how many of all are watched for ten seconds too.
      write: renew this program's section of reports/benchmarks.md.
    """

    pool: str = "dining"
    support: tuple[str, ...] = ("table", "table-0.40x0.50")
    method: tuple[str, ...] = ("random", "clear", "drop")
    num_scenes: int = 512
    num_verified: int = 300
    write: bool = False


@dataclass(frozen=True)
class Checks:
    """What the checks say about N filled scenes of one support and method.

    Attributes:
      name: which.
      first: f64[N, 2], the largest shift (m) and turn (rad) of any object in the first stage.
      second: f64[N, 2], the same by the end of the full check.
      staged, full: bool[N], the scene stands.
      verified: bool[N], it stood for ten seconds; is_verified: bool[N], it was watched so long.
      seconds: CPU time of the staged and of the full check of all N.
    """

    name: str
    first: np.ndarray
    second: np.ndarray
    staged: np.ndarray
    full: np.ndarray
    verified: np.ndarray
    is_verified: np.ndarray
    seconds: tuple[float, float]


def main(args: LastCheck) -> None:
    """Runs the comparison and prints it."""
    report("last_check", body_of(measure(args), args), write=args.write)


def measure(args: LastCheck) -> list[Checks]:
    """One entry for each support and method that filled a scene."""
    cases = [(support, method) for support in args.support for method in args.method]
    checks = (_measure_case(args, *case, -(-args.num_verified // len(cases))) for case in cases)
    return [each for each in checks if len(each.full)]


def _measure_case(args: LastCheck, support: str, method: str, num_verified: int) -> Checks:
    pool = find_pool(args.pool)
    placement = PlacementConfig(num_objects=min(10, len(pool)), history_stride=0)
    config = ProblemConfig(pool=args.pool, support=support, engine="native", placement=placement)
    problem = make_problem(config)
    scenes = make_block_sampler(problem.rules, method)(args.num_scenes, 0)
    rows = np.flatnonzero(scenes.is_filled)
    poses, is_placed = placed_poses(scenes, rows, problem.world.num_objects)
    layout = problem.world.layout
    staged = config.stability
    full = _unstaged(staged, staged.stand_full_steps)
    _, first, _ = _check(
        layout, replace(staged, stand_full_steps=staged.stand_steps), poses, is_placed
    )
    stands, _, staged_seconds = _check(layout, staged, poses, is_placed)
    stands_full, second, full_seconds = _check(layout, full, poses, is_placed)
    chosen = _to_verify(second[:, 0], num_verified)
    verify = _unstaged(staged, _VERIFY_STEPS)
    verified = np.zeros(len(rows), bool)
    verified[chosen], _, _ = _check(layout, verify, poses[chosen], is_placed[chosen])
    return Checks(
        name=f"{method}, {support}",
        first=first,
        second=second,
        staged=stands,
        full=stands_full,
        verified=verified,
        is_verified=np.isin(np.arange(len(rows)), chosen),
        seconds=(staged_seconds, full_seconds),
    )


def _unstaged(config: StabilityConfig, num_steps: int) -> StabilityConfig:
    """The second stage's limits after `num_steps`, for all: with as many steps, the stages are one."""
    return replace(
        config,
        stand_steps=num_steps,
        stand_full_steps=num_steps,
        stand_shift=config.stand_full_shift,
        stand_turn=config.stand_full_turn,
    )


def _check(
    layout: Layout, config: StabilityConfig, poses: np.ndarray, is_placed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Which scenes stand, bool[N]; their largest shift and turn, f64[N, 2]; CPU seconds."""
    engine = NativePhysics(layout, config, num_threads=1)
    engine.stand_batch(poses[:1], is_placed[:1], np.ones(len(poses[:1]), bool))
    started = time.process_time()
    standing = engine.stand_batch(poses, is_placed, np.ones(len(poses), bool))
    seconds = time.process_time() - started
    moved = np.stack([standing.shift.max(-1, initial=0.0), standing.turn.max(-1, initial=0.0)], -1)
    return standing.verdict == Verdict.STABLE, moved.astype(np.float64), seconds


def _to_verify(shift: np.ndarray, number: int) -> np.ndarray:
    """Half of them those that moved most by the end of the full check, the others at random."""
    order = np.argsort(-shift)
    most = order[: number // 2]
    rest = order[number // 2 :]
    others = np.random.default_rng(0).permutation(rest)[: number - len(most)]
    return np.sort(np.concatenate([most, others]))


def body_of(checks: list[Checks], args: LastCheck) -> str:
    """The section: agreement by case, what thresholds would do, and what it costs."""
    config = StabilityConfig()
    cases = f"""{sum(len(each.full) for each in checks):,} filled scenes of ten objects of {args.pool}.
        Staged: {config.stand_steps} steps, and what moved less than {1000 * config.stand_shift:g} mm and
        {np.degrees(config.stand_turn):g} degrees stands; the others go on to {config.stand_full_steps} steps
        and stand under {1000 * config.stand_full_shift:g} mm and {np.degrees(config.stand_full_turn):g}
        degrees. Full: {config.stand_full_steps} steps for all. In mm: the most that any object moved in the
        first stage."""
    thresholds = """What another first threshold would do to all these scenes (its limit of turn is a degree
        per mm):"""
    limits = """What another limit at the end of the full check would do (again a degree per mm, at most 5),
        against the scenes that were watched for 10 s:"""
    parts = [
        "## The last check: staged or full",
        prose(cases),
        _cases_table(checks),
        prose(thresholds),
        _thresholds_table(checks),
        prose(limits),
        _limits_table(checks),
    ]
    return "\n\n".join(parts)


def _cases_table(checks: list[Checks]) -> str:
    rows = [[each.name, *_case_row([each])] for each in checks]
    if checks:
        rows.append(["all", *_case_row(checks)])
    header = [
        "",
        "scenes",
        "both: stands",
        "both: crept",
        "staged only",
        "full only",
        "10 s: stand",
    ]
    header += ["staged stands, 10 s not", "median mm", "99 % mm", "staged: CPU ms a scene", "full"]
    return table(header, rows)


def _case_row(checks: list[Checks]) -> list[str]:
    staged = _joined(checks, "staged")
    full = _joined(checks, "full")
    verified = _joined(checks, "verified")
    watched = _joined(checks, "is_verified")
    shift = 1000 * np.concatenate([each.first[:, 0] for each in checks])
    seconds = np.sum([each.seconds for each in checks], axis=0)
    return [
        f"{len(full):,}",
        f"{(staged & full).sum():,}",
        f"{(~staged & ~full).sum()}",
        f"{(staged & ~full).sum()}",
        f"{(~staged & full).sum()}",
        f"{(verified & watched).sum()} of {watched.sum()}",
        f"{(staged & watched & ~verified).sum()}",
        *(f"{each:.5f}" for each in np.percentile(shift, [50, 99])),
        *(f"{each:.1f}" for each in 1000 * seconds / len(full)),
    ]


def _thresholds_table(checks: list[Checks]) -> str:
    first = np.concatenate([each.first for each in checks]) if checks else np.zeros((0, 2))
    full = _joined(checks, "full")
    watched = _joined(checks, "is_verified")
    verified = _joined(checks, "verified")
    rows = []
    for limit in _THRESHOLDS_MM:
        passes = (1000 * first[:, 0] <= limit) & (np.degrees(first[:, 1]) <= limit)
        wrong = passes & ~full
        later = passes & watched & ~verified
        rows.append(
            [f"{limit:g} mm", f"{passes.sum():,}", (~passes).sum(), wrong.sum(), later.sum()]
        )
    header = ["first threshold", "pass the first stage", "go on", "pass it but fail the full check"]
    return table([*header, "pass it but do not stand 10 s"], rows)


def _limits_table(checks: list[Checks]) -> str:
    second = np.concatenate([each.second for each in checks]) if checks else np.zeros((0, 2))
    watched = _joined(checks, "is_verified")
    verified = _joined(checks, "verified")
    rows = []
    for limit in _LIMITS_MM:
        passes = (1000 * second[:, 0] <= limit) & (np.degrees(second[:, 1]) <= limit)
        falls = watched & ~verified
        stands = watched & verified
        rows.append(
            [f"{limit:g} mm", f"{passes.sum():,}", (passes & falls).sum(), (~passes & stands).sum()]
        )
    header = ["second limit", "pass", "pass but do not stand 10 s", "refused but stand 10 s"]
    return table(header, rows)


def _joined(checks: list[Checks], field: str) -> np.ndarray:
    return np.concatenate([getattr(each, field) for each in checks] or [np.zeros(0, bool)])


if __name__ == "__main__":
    main(tyro.cli(LastCheck))
