"""Grasps in clutter: a network against geometry, in VGN's rounds of clearing piles.

    PILES='--pool all --objects "width<0.2 and height<0.2" --support table --region 0.28x0.28 --method pile'
    eval cluttergen generate $PILES --num-objects 5 -n 2000 --no-render --out out/grasps/piles
    cluttergen robot dataset out/grasps/piles --num-lifts 20 --out out/grasps/data
    eval cluttergen generate $PILES --num-objects 5 -n 100 --seed 1 --no-render --out out/grasps/five
    eval cluttergen generate $PILES --num-objects 10 -n 100 --seed 2 --no-render --out out/grasps/ten
    python -m studies.benchmarks.grasp_network --banks out/grasps/five out/grasps/ten [--write]

Piles are as VGN has them: let fall between walls that are then taken away, all in its cube.
`--support bin` instead of table and region makes them harder: the cube does not hold all of the bin, and the
hand seldom comes past its walls.

The network learns from the labelled grasps of `robot dataset`, and from some that geometry finds in the same
volumes and that are labelled there (`grasp_labels`). Of those in a volume it says of which it is surest
(`grasp_learning`). Beside it stand the same grasps without learning (`grasp_geometry`), the best one and, as
the floor, any of those whose open hand is clear. All clear the same piles, which nobody learnt from
(`grasp_rounds`). Everything is kept in `out`, so that the same command goes on after Ctrl-C; processes with
other `contenders` may run beside each other once the network is there. On one busy core a pile's labels of
`robot dataset` take 2 s, those of found grasps 3 s, learning half an hour, and a round 16 s with the network
and 5 s without it.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from cluttergen_jax.downstream.fitting import FitConfig, blank_params, in_parts
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.ppo.checkpoint import folder_hash, read_policy, read_record
from cluttergen_jax.progress import Progress
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.scene import read_scenes
from cluttergen_jax.schema import digest_of
from cluttergen_jax.statistics import wilson
from studies.benchmarks.grasp_geometry import OpenHand
from studies.benchmarks.grasp_labels import label_volumes
from studies.benchmarks.grasp_learning import GraspLearner, GraspTraining, read_examples
from studies.benchmarks.grasp_rounds import ByGeometry, ByNetwork, Proposer, Sight, run_round
from studies.benchmarks.rows import Row, Rows
from studies.benchmarks.section import prose, report, table

CONTENDERS = {
    "network": "the antipodal grasp of which it is surest, of those whose open hand is clear",
    "geometry": "the best antipodal grasp of the volume, of those whose open hand is clear",
    "random": "any antipodal grasp whose open hand is clear",
}
_AT_ONCE = 512
_HEAD = (
    "proposed by",
    "lifted, of attempts",
    "cleared, of objects",
    "failures",
    "gave up",
    "CPU-s a round",
)


@dataclass(frozen=True)
class GraspNetworkBench:
    """What is learnt and judged.

    Attributes:
      datasets: folders of `cluttergen robot dataset` that are learnt from.
      piles: the banks that they are of; num_labelled: scenes of each in which grasps that geometry finds are
        labelled, too.
      banks: folders of piles that are cleared; none of them learnt from.
      out: the folder of the network and of the rounds.
      contenders: who clears the piles.
      num_rounds: piles of each bank that each clears.
      num_epochs: times that all labelled grasps are learnt from.
      batch_size: labelled grasps a step; learning_rate: of AdamW.
      num_views, noise: how piles are seen, as `robot dataset` has it.
      robot: whose hand it is.
      seed: of weights, views and choices. workers: processes that label grasps.
      write: put the section into reports/benchmarks.md.
    """

    datasets: tuple[Path, ...] = (Path("out/grasps/data"),)
    piles: tuple[Path, ...] = (Path("out/grasps/piles"),)
    num_labelled: int = 700
    banks: tuple[Path, ...] = (Path("out/grasps/five"),)
    out: Path = Path("out/grasps/network")
    contenders: tuple[str, ...] = tuple(CONTENDERS)
    num_rounds: int = 100
    num_epochs: int = 8
    batch_size: int = 256
    learning_rate: float = 2e-3
    num_views: int = 6
    noise: float = 1.0
    robot: str = "panda"
    seed: int = 0
    workers: int = 2
    write: bool = False

    def __post_init__(self) -> None:
        if unknown := set(self.contenders) - set(CONTENDERS):
            raise ConfigError(f"contenders {sorted(unknown)}", ", ".join(CONTENDERS))
        if len(self.piles) != len(self.datasets):
            raise ConfigError(
                f"{len(self.piles)} banks of piles for {len(self.datasets)} datasets",
                "one for each",
            )


def learn(args: GraspNetworkBench) -> Path:
    """The checkpoint's folder, once the network is fitted; at once if it is."""
    data = [digest_of((each / "voxels/grasps.csv").read_bytes()) for each in args.datasets]
    robot = find_robot(args.robot).hash
    labels = [args.out / f"labels-{digest_of((each + robot).encode())[:8]}" for each in data]
    for bank, dataset, folder in zip(args.piles, args.datasets, labels, strict=True):
        label_volumes(bank, dataset, folder, args.robot, args.num_labelled, args.workers)
    config = FitConfig(
        num_epochs=args.num_epochs,
        batch_size=args.batch_size,
        learning_rate=args.learning_rate,
        seed=args.seed,
    )
    read = partial(read_examples, args.datasets, labels)
    files = [file for folder in labels for file in sorted(folder.iterdir())]
    data.append(digest_of(b"".join(file.read_bytes() for file in files)))
    return GraspTraining(GraspLearner(), config, read, data, args.out / "learning").run()


def proposer_of(args: GraspNetworkBench, contender: str, hand: OpenHand, weights: Path) -> Proposer:
    """Who is called so.

    Args:
      hand: that has to be clear. weights: the network's folder.
    """
    if contender in ("geometry", "random"):
        return ByGeometry(hand, contender == "random")
    learner = GraspLearner()
    params = read_policy(weights, blank_params(learner))
    call = jax.jit(partial(learner.logits, params))

    def score(seen: dict[str, np.ndarray]) -> np.ndarray:
        return np.concatenate(list(in_parts(call, seen, _AT_ONCE)))

    return ByNetwork(score, hand)


def clear_piles(args: GraspNetworkBench, weights: Path, path: Path) -> dict[str, list[Row]]:
    """The rounds of each contender on the first piles of a bank."""
    bank = read_bank(path)
    scenes = list(read_scenes(bank))[: args.num_rounds]
    hand = OpenHand(find_robot(args.robot), bank.support)
    made = {}
    for contender in args.contenders:
        name = f"{path.resolve().name}-{contender}"
        file = (
            args.out / f"rounds/{name}-{_settings_key(args, contender, bank.recipe, weights)}.json"
        )
        propose = proposer_of(args, contender, hand, weights)
        made[contender] = _clear(
            args, name, Rows(file, float("inf"), say=lambda text: None), propose, scenes
        )
    return made


def _settings_key(
    args: GraspNetworkBench, contender: str, recipe: Mapping[str, Any], weights: Path
) -> str:
    """What tells rounds from those of other settings."""
    settings = {"bank": recipe, "robot": find_robot(args.robot).hash, "seed": args.seed}
    settings |= {"num_views": args.num_views, "noise": args.noise}
    if contender == "network":
        settings |= {"weights": folder_hash(weights, ["weights.npz"])}
    return digest_of(json.dumps(settings, sort_keys=True, default=str).encode())[:8]


def _clear(
    args: GraspNetworkBench, name: str, rows: Rows, propose: Proposer, scenes: Sequence[Scene]
) -> list[Row]:
    """The rounds of one contender, each kept when it is over."""
    with Progress(name, len(scenes), "round") as progress:
        for scene in scenes:
            rows.make(
                "rounds", iter([(str(scene.origin.index), partial(_row, args, scene, propose))])
            )
            progress.update(1, _told(rows.of("rounds")))
    of = rows.of("rounds")
    return [of[str(each.origin.index)] for each in scenes if str(each.origin.index) in of]


def _row(args: GraspNetworkBench, scene: Scene, propose: Proposer) -> Row:
    began = time.process_time()
    sight = Sight(args.num_views, args.noise)
    found = run_round(
        scene, find_robot(args.robot), propose, sight, (args.seed, scene.origin.index)
    )
    return {
        "num_objects": found.num_objects,
        "ends": list(found.ends),
        "seconds": time.process_time() - began,
    }


def _told(rows: Mapping[str, Row]) -> str:
    cleared = sum(row["ends"].count("lifted") for row in rows.values())
    return f"{cleared} of {sum(row['num_objects'] for row in rows.values())} cleared"


def share_text(good: int, number: int) -> str:
    """A share in per cent with its 95 % interval, and of how many."""
    low, high = wilson(good, number)
    return f"{100 * good / max(number, 1):.1f} % ({100 * low:.0f} to {100 * high:.0f}) of {number}"


def round_cells(name: str, rows: Sequence[Row]) -> list[str]:
    """A contender's line in the table."""
    ends = Counter(end for row in rows for end in row["ends"])
    num_objects = sum(row["num_objects"] for row in rows)
    causes = ", ".join(
        f"{cause} {number}" for cause, number in ends.most_common() if cause != "lifted"
    )
    num_given_up = sum(_is_given_up(row) for row in rows)
    return [
        name,
        share_text(ends["lifted"], ends.total()),
        share_text(ends["lifted"], num_objects),
        causes or "-",
        str(num_given_up),
        f"{sum(row['seconds'] for row in rows) / max(len(rows), 1):.1f}",
    ]


def _is_given_up(row: Row) -> bool:
    """Whether a round ended because nothing was proposed."""
    ends = row["ends"]
    left = row["num_objects"] - row["ends"].count("lifted")
    has_failed_twice = len(ends) > 1 and all(each != "lifted" for each in ends[-2:])
    return left > 0 and not has_failed_twice


def body_of(args: GraspNetworkBench) -> str:
    """The section."""
    weights = learn(args)
    record = read_record(weights)
    told = record["validation"]
    fit = record["fit"]
    parts = []
    for path in args.banks:
        made = clear_piles(args, weights, path)
        num_objects = Counter(row["num_objects"] for rows in made.values() for row in rows)
        mean = sum(number * count for number, count in num_objects.items()) / max(
            num_objects.total(), 1
        )
        text = prose(
            f"""`{path.resolve().name}`: {len(next(iter(made.values())))} piles, of {mean:.1f} objects in the
            cube in the mean."""
        )
        rows = [round_cells(name, each) for name, each in made.items()]
        parts.append(f"{text}\n\n{table(_HEAD, rows)}")
    meaning = "; ".join(f"`{name}`: {CONTENDERS[name]}" for name in args.contenders)
    text = prose(
        f"""Rounds as in VGN (Breyer et al., 2020): until no object is left, nothing is proposed or two
        attempts in a row fail; {args.num_views} views with noise {args.noise:g} before each. A grasp whose
        open hand touches something there or on its last 10 cm is `blocked`; the others are executed by the
        lift of `robot dataset`. {meaning}. In brackets 95 % intervals (Wilson), as if objects were
        independent."""
    )
    words = {
        "found": "found in the volumes of scenes held out",
        "drawn": "drawn on the shapes there",
    }
    shares = "; ".join(
        f"of the {told[f'{name}_grasps']:.0f} grasps {meant} ({100 * told[f'{name}_good']:.0f} % lift)"
        f" it tells {100 * told[f'{name}_accuracy']:.1f} % rightly, area under the curve"
        f" {told[f'{name}_area']:.3f}"
        for name, meant in words.items()
        if f"{name}_grasps" in told
    )
    learnt = prose(
        f"""The network: {fit["num_epochs"]} epochs in batches of {fit["batch_size"]} labelled grasps;
        {shares}."""
    )
    return "\n\n".join(["## Grasps in clutter: a network and geometry", text, learnt, *parts])


def main(args: GraspNetworkBench) -> None:
    """Measures and reports."""
    report("grasp_network", body_of(args), write=args.write, packages=("mujoco", "jax", "flax"))


if __name__ == "__main__":
    main(tyro.cli(GraspNetworkBench))
