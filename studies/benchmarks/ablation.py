"""What helps the learned generator: the same budget for every row, one thing changed at a time.

    python -m studies.benchmarks.ablation --write

A row that has been trained is kept in `--out` and not trained again; Ctrl-C and the same command go on. A row
that was trained with other settings is refused.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cluttergen_jax.config import Preset
from cluttergen_jax.learning.ppo.checkpoint import has_state, read_record
from cluttergen_jax.learning.training.presets import Settings
from cluttergen_jax.learning.training.run_folder import Interrupt, RunFolder
from cluttergen_jax.learning.training.run_logger import read_rows
from cluttergen_jax.learning.training.train import TrainConfig, recipe_of, run_training
from cluttergen_jax.placement import PlacementConfig
from cluttergen_jax.placement.problem import ProblemConfig
from studies.benchmarks.section import prose, report, table
from studies.benchmarks.trained import WINDOW, success_of


@dataclass(frozen=True)
class Row:
    """A run.

    Attributes:
      name: its folder's. title: what is changed, for people.
      variant, preset: what it starts from. network, ppo, placement, stability: fields that are changed.
    """

    name: str
    title: str
    variant: str = "policy"
    network: dict[str, Any] = field(default_factory=dict)
    ppo: dict[str, Any] = field(default_factory=dict)
    placement: dict[str, Any] = field(default_factory=dict)
    stability: dict[str, Any] = field(default_factory=dict)
    preset: Preset = "cpu"


ROWS = (
    Row(
        "preset",
        "preset `cpu`: mixture of Betas over 20 x 20 cells and 8 turns that sees the room for the object",
    ),
    Row("blind", "it is told of heights alone", network={"room": False}),
    Row(
        "beta",
        "one Beta a coordinate (the paper's head), z about rest on the bare top",
        network={"head": "beta"},
    ),
    Row(
        "normal",
        "one truncated normal a coordinate, z about rest on the bare top",
        variant="normal",
    ),
    Row("open_loop", "no history", variant="open_loop"),
    Row("narrow", "a fifth of the entropy bonus", ppo={"entropy_cost": 0.002}),
    Row(
        "far",
        "it looks farther ahead: discount 0.99, GAE 0.95",
        ppo={"discount": 0.99, "gae_lambda": 0.95},
    ),
    Row(
        "undersides",
        "what is lower than the object's underside is not in its way; 16 turns, opposite ones told apart",
        network={"num_turns": 16, "turn_symmetry": 1, "undersides": True},
    ),
    Row(
        "both",
        "the last two at once, as the shipped policy of the kitchen was trained",
        network={"num_turns": 16, "turn_symmetry": 1, "undersides": True},
        ppo={"discount": 0.99, "gae_lambda": 0.95},
    ),
)


def train(
    row: Row,
    out: Path,
    problem: ProblemConfig,
    num_attempts: int,
    seed: int,
    encoder: str | None,
    interrupt: Interrupt | None = None,
    **given: Any,
) -> None:
    """Trains and evaluates one row, or takes it up again; one that is finished is left alone.

    Args:
      interrupt: see `run_training`; given: further fields of `TrainConfig`.

    Raises:
      ConfigError: its folder holds a run with other settings.
    """
    config, settings = settings_of(row, out, problem, num_attempts, seed, encoder, **given)
    RunFolder(config.folder, recipe_of(config, settings))
    if not is_finished(config.folder):
        run_training(config, settings, interrupt=interrupt)


def settings_of(
    row: Row,
    out: Path,
    problem: ProblemConfig,
    num_attempts: int,
    seed: int,
    encoder: str | None,
    **given: Any,
) -> tuple[TrainConfig, Settings]:
    """What a row's run is given; see `train`."""
    config = TrainConfig(
        problem=problem,
        preset=row.preset,
        variant=row.variant,
        num_attempts=num_attempts,
        seed=seed,
        encoder_weights=encoder if row.preset != "cpu" else None,
        out=str(out / row.name),
        **given,
    )
    settings = config.settings()
    settings = replace(
        settings,
        network=replace(settings.network, **row.network),
        ppo=replace(settings.ppo, **row.ppo),
        placement=replace(settings.placement, **row.placement),
        stability=replace(settings.stability, **row.stability),
    )
    return replace(
        config, encoder_weights=None
    ) if "scene_encoder" in row.network else config, settings


def is_finished(folder: Path) -> bool:
    """Whether a run was trained to its end: its policy is evaluated last of all."""
    policy = folder / "policy"
    is_there = has_state(folder / "last") and (policy / "record.json").exists()
    return is_there and "evaluation" in read_record(policy)


def cells(row: Row, out: Path) -> list[str]:
    """A finished row of the table."""
    rows = read_rows(out / row.name / "progress.csv")
    success = np.array([each["success"] for each in rows])
    ends = [-(-len(rows) * part // 4) for part in (1, 2, 4)]
    interval = success_of(read_record(out / row.name / "policy"))
    means = [f"{success[max(end - WINDOW, 0) : end].mean():.2f}" for end in ends]
    return [row.title, *means, interval, f"{rows[-1]['entropy']:.1f}"]


def compare(
    rows: Sequence[Row],
    name: str,
    title: str,
    pool: str,
    about: str | None,
    needs_encoder: bool = False,
    num_objects: int = 10,
    differs: str = "one thing differs from the first row in each unless it says otherwise",
) -> None:
    """Trains what is missing of the rows and writes a section: the program that the command line runs.

    Args:
      pool, num_objects: of scenes; differs: what rows differ in, for people.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--out", type=Path, default=Path("runs") / name)
    parser.add_argument("--pool", default=pool)
    parser.add_argument("--num-attempts", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--encoder-weights", required=needs_encoder, help="of `cluttergen pretrain`"
    )
    names = [row.name for row in rows]
    parser.add_argument(
        "--rows", nargs="+", choices=names, help="these alone, such as with a larger budget"
    )
    parser.add_argument(
        "--write", action="store_true", help="put the section into reports/benchmarks.md"
    )
    args = parser.parse_args()
    if args.rows and args.write:
        parser.error("--write puts the whole section into the file: it takes no --rows")
    rows = [row for row in rows if args.rows is None or row.name in args.rows]
    for row in rows:
        placement = PlacementConfig(num_objects=num_objects)
        problem = ProblemConfig(pool=args.pool, placement=placement)
        train(row, args.out, problem, args.num_attempts, args.seed, args.encoder_weights)
    body = prose(
        f"""{num_objects} objects of {args.pool} on the paper's table, {args.num_attempts:,} attempts each,
        seed {args.seed}; {differs}. While training:
        mean success over the {WINDOW} updates before a quarter, half and all of the attempts. Whole check: of
        256 fresh episodes, actions sampled, with the 95 % interval."""
    )
    header = ["", "a quarter", "half", "all", "whole check", "entropy (nats)"]
    lines = table(header, [cells(row, args.out) for row in rows])
    report(name, f"## {title}\n\n{body}\n\n{lines}", write=args.write)


if __name__ == "__main__":
    # The pool that is hardest to fill.
    compare(ROWS, "ablation", "What helps the policy", "kitchen", __doc__)
