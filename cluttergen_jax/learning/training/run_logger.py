"""Logs of a run: metrics as CSV, TensorBoard and Weights & Biases, checkpoints, evaluations, the curve."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypedDict

import jax
import numpy as np
from tqdm import tqdm

from cluttergen_jax.assets import public_name
from cluttergen_jax.errors import MissingExtraError
from cluttergen_jax.files import write_atomically
from cluttergen_jax.learning.ppo.checkpoint import save_policy
from cluttergen_jax.learning.ppo.ppo import PPOConfig, TrainState
from cluttergen_jax.learning.training.run_folder import RunFolder
from cluttergen_jax.plots import FONT, PAGE, colour, grid_of_panels, prepare, save
from cluttergen_jax.progress import Progress
from cluttergen_jax.schema import Record

Figures = dict[str, np.ndarray]
"""Of one update, by name."""
Row = dict[str, float]


class Sink(Protocol):
    """Something that follows a run's figures from outside, such as TensorBoard."""

    def add(self, row: Row, group: str) -> None:
        """One row; `group` is "" for training's figures, or a prefix such as "evaluation/"."""
        ...

    def close(self) -> None:
        """All rows have been given."""
        ...


class MetricsLog:
    """Appends rows to a CSV file; a run that is taken up again continues it.

    Args:
      path: the file.
      first_update: rows from this update on are dropped: they are about to be made again.
      sinks: are given every new row too.
      group: the rows' prefix there.
    """

    def __init__(
        self, path: Path, first_update: int = 0, sinks: Sequence[Sink] = (), group: str = ""
    ) -> None:
        self.path = path
        self._sinks = sinks
        self._group = group
        self.rows = [row for row in read_rows(path) if row["update"] < first_update]
        if self.rows or path.exists():
            self._rewrite()

    def add(self, row: Row) -> None:
        """Stores the figures of one update."""
        self.rows.append(row)
        if len(self.rows) == 1:
            self._rewrite()
        else:
            with self.path.open("a", newline="") as file:
                csv.DictWriter(file, fieldnames=list(self.rows[0])).writerow(row)
        for sink in self._sinks:
            sink.add(row, self._group)

    def _rewrite(self) -> None:
        text = io.StringIO()
        if self.rows:
            writer = csv.DictWriter(text, fieldnames=list(self.rows[0]))
            writer.writeheader()
            writer.writerows(self.rows)
        write_atomically(self.path, text.getvalue().encode())


class TensorBoard:
    """A `Sink` that writes TensorBoard's event files."""

    def __init__(self, folder: Path) -> None:
        from tensorboardX import SummaryWriter

        self._writer = SummaryWriter(str(folder / "tensorboard"))

    def add(self, row: Row, group: str) -> None:
        """See `Sink.add`."""
        for name, value in row.items():
            self._writer.add_scalar(group + name, value, int(row["attempts"]))

    def close(self) -> None:
        """See `Sink.close`."""
        self._writer.close()


def read_rows(path: Path) -> list[Row]:
    """The rows of a file of `MetricsLog`; none if there is no such file.

    A last row that was cut short, as by a full disk, is left out.
    """
    if not path.exists():
        return []
    with path.open(newline="") as file:
        found = [_numbers(row) for row in csv.DictReader(file)]
    return [row for row in found if row is not None]


def _numbers(row: Mapping[str, str]) -> Row | None:
    try:
        return {name: float(value) for name, value in row.items()}
    except (TypeError, ValueError):
        return None


POLICY = colour("policy")
PANELS = (
    ("success", "success rate"),
    ("num_placed", "objects placed"),
    ("entropy", "entropy (nats)"),
)


def draw_curve(
    rows: list[Row],
    path: Path,
    title: str,
    evaluations: Sequence[Row] = (),
    random: float | None = None,
) -> None:
    """Success, objects placed and entropy against attempts; evaluated success as points.

    Args:
      path: of the picture; the same as a PDF lies beside it.
      evaluations: of whole last checks; random: the rate of `random` in the same world, where it is known.
    """
    attempts = [row["attempts"] / 1000 for row in rows]
    figure, axes = grid_of_panels(len(PANELS), 3, PAGE / 3, 2.2)
    for axis, (name, label) in zip(axes, PANELS, strict=True):
        # A single row makes no line.
        marker = "." if len(rows) == 1 else ""
        values = [row[name] for row in rows]
        axis.plot(attempts, values, marker=marker, linewidth=1.0, color=POLICY, label="training")
        prepare(axis, label, "attempts (thousands)")
    if random is not None:
        style = {"color": colour("random"), "linestyle": "--", "linewidth": 1.0}
        axes[0].axhline(random, label="random, last check", **style)
    if evaluations:
        _draw_evaluations(axes[0], evaluations)
    axes[0].legend(fontsize=FONT - 1, frameon=False, loc="best")
    # Room for a line at 0 or 1, which the frame would hide.
    axes[0].set_ylim(-0.03, 1.03)
    figure.suptitle(title, fontsize=FONT + 1)
    save(figure, path.with_suffix(""))


def _draw_evaluations(axis: Any, evaluations: Sequence[Row]) -> None:
    """The rate of whole last checks with its 95 % interval."""
    success = [row["success"] for row in evaluations]
    below = [row["success"] - row["low95"] for row in evaluations]
    above = [row["high95"] - row["success"] for row in evaluations]
    attempts = [row["attempts"] / 1000 for row in evaluations]
    style = {"fmt": "o", "markersize": 3, "linewidth": 1, "color": "black", "capsize": 2}
    axis.errorbar(attempts, success, yerr=[below, above], label="last check, 95 %", **style)


PROJECT = "cluttergen"


class WandbLog:
    """A `Sink` that sends every row to Weights & Biases.

    A run that is taken up again goes on where it was: its id is made from its folder.

    Args:
      folder: of the run; its name is the run's.
      recipe: JSON values that describe the run.

    Raises:
      MissingExtraError: wandb is not installed.
    """

    def __init__(self, folder: Path, recipe: Record) -> None:
        try:
            import wandb
        except ImportError as error:
            raise MissingExtraError("wandb", "`wandb`") from error
        identity = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
        self._run = wandb.init(
            project=PROJECT,
            name=folder.name,
            id=identity,
            resume="allow",
            dir=str(folder),
            config=recipe,
        )

    def add(self, row: Row, group: str) -> None:
        """See `Sink.add`; the step is the number of attempts."""
        self._run.log(
            {group + name: value for name, value in row.items()}, step=int(row["attempts"])
        )

    def close(self) -> None:
        """See `Sink.close`."""
        self._run.finish()


class SuccessRate(TypedDict):
    """The success over fresh episodes with its 95 % interval, and the share whose every slot was filled."""

    success: float
    low95: float
    high95: float
    filled: float
    episodes: int


class Evaluation(SuccessRate, total=False):
    """The success of weights by the whole last check, how it was found, and what stands beside it."""

    action: str
    last_check_steps: int
    random: SuccessRate
    training_success: float
    training_updates: int


Evaluate = Callable[[Any], Evaluation]

_SHOWN = (
    ("success", "success", ".2f"),
    ("placed", "num_placed", ".2f"),
    ("steps", "stable_steps", ".0f"),
    ("value loss", "value_loss", ".3g"),
    ("entropy", "entropy", ".2f"),
    ("KL", "kl", ".4f"),
)
"""Label, metric, format."""


@dataclass(frozen=True)
class RunConfig:
    """How a run is watched over.

    Attributes:
      seed: of weights, episodes and actions.
      window: updates over which the success that decides on "best" is averaged; also the most updates that
        are made in one compiled call.
      longest_call: seconds that such a call may take, if it makes more than one update.
      eval_every: attempts between evaluations; 0 evaluates at the end only.
      memory_limit: bytes that the run may need; None takes what is free.
      wandb: send the figures to Weights & Biases too.
    """

    seed: int = 0
    window: int = 10
    longest_call: float = 4.0
    eval_every: int = 0
    memory_limit: int | None = None
    wandb: bool = False


class RunLogger:
    """Writes files into the run's folder and shows a progress bar.

    Args:
      kept: the run's folder, and the recipe that is stored in every checkpoint.
      config: how the run is watched over; ppo: the numbers.
      first: the first update to come; what the folder says of later ones is dropped.
      show: for lines that stay.
    """

    def __init__(
        self,
        kept: RunFolder,
        config: RunConfig,
        ppo: PPOConfig,
        first: int,
        show: Callable[[str], None],
    ) -> None:
        folder = kept.path
        self._kept = kept
        self._folder = folder
        self._show = show
        self._batch = ppo.batch_size
        self._window = config.window
        self._total = ppo.num_updates * ppo.batch_size
        self._first = first * ppo.batch_size
        self._progress: Progress | None = None
        self._sinks: list[Sink] = [TensorBoard(folder)]
        if config.wandb:
            self._sinks.append(WandbLog(folder, kept.recipe))
        self._updates = MetricsLog(folder / "progress.csv", first, self._sinks)
        # An evaluation is of the weights after so many updates; that of the present ones stays.
        evaluations = folder / "evaluations.csv"
        self._evaluations = MetricsLog(evaluations, first + 1, self._sinks, group="evaluation/")
        self._best = float(kept.record("best").get("success", -1.0))

    def begin(self) -> None:
        """Updates begin now: what came before was compilation."""
        self._progress = Progress("training", self._total, "attempt", kept=self._first)

    def say(self, text: str) -> None:
        """A line for people."""
        with tqdm.external_write_mode():
            self._show(text)

    def add(self, rows: list[Figures], first: int, seconds: float) -> None:
        """The figures of updates made in one call.

        Args:
          first: the number of the first of them; seconds: what each took.
        """
        for number, figures in enumerate(rows, first):
            self._updates.add(_row(number, self._batch, figures, seconds))
        if rows and self._progress is not None:
            self._progress.update(len(rows) * self._batch, _note(self._updates.rows[-1]))

    def keep_best(self, state: TrainState) -> None:
        """Stores the weights if training's success is higher than ever."""
        if self._success > self._best:
            self._best = self._success
            self._save("best", state, {"success": self._success})

    def save_state(self, state: TrainState) -> None:
        """Stores what the run goes on from."""
        self._kept.save(state, num_updates=int(state.num_updates))

    def save_policy(self, state: TrainState, evaluation: Evaluation | None = None) -> None:
        """Stores the weights, what is known of how good they are, and the curve so far."""
        rows = self._updates.rows
        if not rows:
            return
        known = {"evaluation": self._beside(evaluation)} if evaluation else {}
        found: Any = evaluation or {}
        random = found["random"]["success"] if "random" in found else None
        path = self._folder / "curve.png"
        draw_curve(rows, path, self._title, self._evaluations.rows, random)
        # Last: by the policy's record a run is known to be done.
        self._save("policy", state, {"success": rows[-1]["success"], **known})

    @property
    def _title(self) -> str:
        """What was trained, for people."""
        recipe = self._kept.recipe
        pool = public_name(str(recipe["pool"])) if "pool" in recipe else self._folder.name
        words = [f"{name} {recipe[name]}" for name in ("preset", "seed") if name in recipe]
        return ", ".join([pool, str(recipe.get("variant", "policy")), *words])

    @property
    def num_evaluated(self) -> int:
        """Episodes of the stored policy's evaluation; 0 without one."""
        return int(self._kept.record("policy").get("evaluation", {}).get("episodes", 0))

    def complete_policy(self, state: TrainState) -> None:
        """Stores the weights of a whole run whose process ended before it did."""
        if self._kept.record("policy").get("attempts") != int(state.num_updates) * self._batch:
            self.save_policy(state)

    def add_evaluation(self, state: TrainState, evaluation: Evaluation) -> None:
        """Both rates side by side: training's own check of late, and the whole last check."""
        number = int(state.num_updates)
        found = self._beside(evaluation)
        numbers = {
            name: float(value) for name, value in found.items() if isinstance(value, int | float)
        }
        self._evaluations.add({"update": number, "attempts": number * self._batch, **numbers})
        self.say(
            f"evaluation {tqdm.format_sizeof(number * self._batch)} attempts: training's check "
            f"{found['training_success']:.3f}, whole last check {found['success']:.3f} "
            f"[{found['low95']:.3f}, {found['high95']:.3f}] ({found['episodes']} episodes, {found['action']})"
        )
        if "random" in found:
            for line in comparison_lines(found, self._updates.rows):
                self.say(line)

    def close(self) -> None:
        """Nothing more is going to be shown or added."""
        if self._progress is not None:
            self._progress.close()
        for sink in self._sinks:
            sink.close()

    @property
    def _success(self) -> float:
        return float(np.mean([row["success"] for row in self._updates.rows[-self._window :]]))

    def _beside(self, evaluation: Evaluation) -> Evaluation:
        window = min(self._window, len(self._updates.rows))
        return {**evaluation, "training_success": self._success, "training_updates": window}

    def _save(self, name: str, state: TrainState, known: Record) -> None:
        attempts = int(state.num_updates) * self._batch
        record = self._kept.recipe | {"attempts": attempts} | known
        save_policy(self._folder / name, jax.device_get(state.params), record)


class NullLogger:
    """The logger of a process that neither writes nor shows anything."""

    num_evaluated = 0

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_, **__: None


Logger = RunLogger | NullLogger


def _row(number: int, batch_size: int, figures: Figures, seconds: float) -> Row:
    row = {
        name.removeprefix("env/"): float(value)
        for name, value in figures.items()
        if name != "env/reward"
    }
    attempts = (number + 1) * batch_size
    return {
        "update": number,
        "attempts": attempts,
        "attempts_per_second": batch_size / seconds,
        **row,
    }


def _note(row: Row) -> str:
    """The figures that stand beside the bar."""
    return "  ".join(f"{label} {row[name]:{form}}" for label, name, form in _SHOWN if name in row)


_RISE = 0.03
"""How much higher the last quarter's success is than the one before where a curve still rises."""
_EASY = 0.95
_FALLS_LATE = 0.15
_FEWEST = 8


def difference_interval(
    one: Mapping[str, float], other: Mapping[str, float]
) -> tuple[float, float]:
    """The 95 % interval of the difference of two rates (Newcombe, 1998, method 10).

    Args:
      one, other: `success` with its Wilson interval, `low95` and `high95`.
    """
    between = one["success"] - other["success"]
    below = math.hypot(one["success"] - one["low95"], other["high95"] - other["success"])
    above = math.hypot(one["high95"] - one["success"], other["success"] - other["low95"])
    return between - below, between + above


def comparison_lines(
    evaluation: Mapping[str, Any], rows: Sequence[Mapping[str, float]]
) -> list[str]:
    """Lines: the success of `random`, and where the policy is not better, that, and what may be missing.

    Args:
      evaluation: of the policy; its `random` is that of `random`.
      rows: figures of the run's updates.
    """
    random = evaluation["random"]
    rate = f"{random['success']:.3f} [{random['low95']:.3f}, {random['high95']:.3f}]"
    found = f"random     {rate} in the same world ({random['episodes']} episodes): the policy is"
    low, high = difference_interval(evaluation, random)
    if low > 0:
        return [f"{found} better by {low:.3f} to {high:.3f}"]
    verdict = "worse" if high < 0 else "not better"
    return [
        f"{found} {verdict}; the difference lies between {low:.3f} and {high:.3f}",
        f"advice     {_advice(evaluation, rows)}",
    ]


def _advice(evaluation: Mapping[str, Any], rows: Sequence[Mapping[str, float]]) -> str:
    """What the run most likely lacks."""
    if evaluation["random"]["success"] > _EASY:
        return (
            "nothing: `random` fills this world. More objects or a smaller support make it harder"
        )
    number = f"{int(rows[-1]['attempts']):,}"
    if len(rows) < _FEWEST:
        return f"attempts: {number} make {len(rows)} updates, of which nothing can be said"
    success = np.array([row["success"] for row in rows])
    before, last = (float(part.mean()) for part in np.array_split(success, 4)[-2:])
    if last - before > _RISE:
        rise = (
            f"training's success still rises, from {before:.2f} to {last:.2f} in its last quarter"
        )
        return f"attempts: {rise}; give more than {number}"
    passed = evaluation["training_success"]
    if passed - evaluation["success"] > _FALLS_LATE:
        return f"stillness: {passed:.2f} pass training's short check, but move later; try reward 'compressed'"
    return (
        f"an easier start: training's success rises no more ({before:.2f}, then {last:.2f}) after {number} "
        "attempts; fewer objects, a larger support, or variant 'policy' with preset 'cpu' learn sooner, and "
        "method 'guided' needs no training"
    )
