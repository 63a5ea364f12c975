"""Two trainers that are not ours, in the environments made for them: Brax's PPO and Stable-Baselines3's.

    python -m studies.benchmarks.other_trainers --write     # needs the extra sb3

Both are small networks, hardly tuned. Draws docs/images/other_trainers.png.
"""

from __future__ import annotations

import argparse
import functools
import json
import time
from collections import deque
from pathlib import Path

import jax
import numpy as np

import cluttergen_jax as cg
from cluttergen_jax.plots import new_figure, prepare
from studies.benchmarks.section import prose, report, table

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "other_trainers.png"
TASK = {
    "pool": "dining",
    "support": "table",
    "objects": ("mug", "bowl", "dinner_plate", "wine_glass", "bottle"),
    "num_threads": 1,
}
NUM_ENVS = 64
WINDOW = 100
NAMES = {"brax": "Brax 0.14.2, `ppo.train`", "sb3": "Stable-Baselines3, `PPO`"}


def train_brax(num_attempts: int) -> list[list[float]]:
    """Rows of attempts so far, and means of the latest 100 episodes: success, objects placed, attempts."""
    from brax.training.agents.ppo import networks

    env = cg.make_env(**TASK, history_stride=0, num_cells=0, auto_reset=False)
    rows = []

    def keep(attempts: int, figures: dict[str, float]) -> None:
        if "episode/success" not in figures:  # The last call tells of no episodes.
            return
        rows.append(
            [
                attempts,
                *(
                    float(figures[f"episode/{each}"])
                    for each in ("success", "num_placed", "length")
                ),
            ]
        )
        print("brax", rows[-1], flush=True)

    small = functools.partial(
        networks.make_ppo_networks,
        policy_hidden_layer_sizes=(64, 64),
        value_hidden_layer_sizes=(64, 64),
    )
    cg.envs.train_brax(
        env,
        num_timesteps=num_attempts,
        num_envs=NUM_ENVS,
        unroll_length=16,
        batch_size=16,
        num_minibatches=4,
        num_updates_per_batch=8,
        learning_rate=1e-3,
        entropy_cost=1e-3,
        discounting=0.9,
        network_factory=small,
        num_evals=1,
        run_evals=False,
        log_training_metrics=True,
        training_metrics_steps=1024,
        progress_fn=keep,
    )
    return rows


def train_sb3(num_attempts: int) -> list[list[float]]:
    """As `train_brax`."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    class Keep(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.rows: list[list[float]] = []
            self.ends: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)

        def _on_step(self) -> bool:
            ended = (info for info in self.locals["infos"] if "episode" in info)
            self.ends.extend((i["is_success"], i["num_placed"], i["episode"]["l"]) for i in ended)
            return True

        def _on_rollout_end(self) -> None:
            self.rows.append([self.num_timesteps, *np.mean(self.ends, axis=0).tolist()])
            print("sb3", self.rows[-1], flush=True)

    torch.set_num_threads(1)
    envs = cg.envs.make_sb3_env(NUM_ENVS, **TASK, history_stride=0, num_cells=0)
    keep = Keep()
    numbers = {"n_steps": 16, "batch_size": 256, "n_epochs": 8, "gamma": 0.9, "learning_rate": 1e-3}
    PPO("MlpPolicy", envs, **numbers, seed=0, device="cpu").learn(num_attempts, callback=keep)
    return keep.rows


def by_chance() -> list[float]:
    """What `random` does with 256 scenes: success, objects placed, attempts."""
    sample = cg.make_sampler(**TASK, method="random")
    scenes = jax.jit(jax.vmap(sample))(jax.random.split(jax.random.key(0), 256))
    means = (scenes.is_success, scenes.is_placed.sum(-1), scenes.counts.attempts.sum(-1))
    return [float(each.mean()) for each in means]


def trained(name: str, num_attempts: int, folder: Path) -> dict:
    """The curve and the seconds of a training, which is not done again where its file is."""
    path = folder / f"{name}-{num_attempts}.json"
    if not path.exists():
        started = time.monotonic()
        rows = {"brax": train_brax, "sb3": train_sb3}[name](num_attempts)
        found = {"rows": rows, "seconds": time.monotonic() - started}
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found) + "\n")
    return json.loads(path.read_text())


def draw(curves: dict[str, list[list[float]]], chance: list[float]) -> None:
    """Success, and the share of attempts that placed an object, by attempts."""
    figure = new_figure(8, 3)
    titles = ("scenes that stand", "attempts that place an object")
    for axis, title in zip(figure.subplots(1, 2), titles, strict=True):
        is_success = title == titles[0]
        for name, colour in (("brax", "#c8102e"), ("sb3", "#1f77b4")):
            rows = np.array(curves[name])
            values = rows[:, 1] if is_success else rows[:, 2] / rows[:, 3]
            axis.plot(rows[:, 0], values, color=colour, label=NAMES[name].replace("`", ""))
        level = chance[0] if is_success else chance[1] / chance[2]
        axis.axhline(
            level, color="#8a8f98", linestyle="--", label="random, which knows the right height"
        )
        prepare(axis, title, "attempts")
        axis.set_ylim(0, 1)
    figure.axes[0].legend(fontsize=7)
    figure.savefig(PICTURE, dpi=130, metadata={"Software": None})


def section(found: dict[str, dict], chance: list[float], asked: int) -> str:
    """The section of reports/benchmarks.md."""
    rows = []
    for name, each in found.items():
        for label, row in (("first", each["rows"][0]), ("last", each["rows"][-1])):
            attempts, success, placed, length = row
            seconds = f"{each['seconds']:.0f}" if label == "last" else ""
            rows.append(
                (
                    NAMES[name],
                    f"{attempts:,.0f}",
                    f"{success:.2f}",
                    f"{placed:.2f}",
                    f"{placed / length:.2f}",
                    seconds,
                )
            )
    success, placed, length = chance
    rows.append(
        (
            "`random`, 256 scenes",
            "",
            f"{success:.2f}",
            f"{placed:.2f}",
            f"{placed / length:.2f}",
            "",
        )
    )
    text = f"""
        Five objects of dining ({", ".join(TASK["objects"])}) on its table, in random order: small networks
        that see which object is next and where the others stand, one Gaussian over x, y, z and turn, one
        thread for the simulation. Means of the latest {WINDOW} episodes at the first and the last point of
        the curves. `random` is told the right height, which the trainers have to find out. One seed each,
        hardly tuned, with minibatches, entropy bonus and first spread of their own: that they learn at all
        is what this shows, not which of them is better. The task is an easy one, chosen for that.
    """
    if any(each["rows"][-1][0] < asked for each in found.values()):
        text += f" They ended before the {asked:,} attempts that were asked for."
    header = ("", "attempts", "scenes that stand", "objects placed", "placed an attempt", "seconds")
    picture = "![Curves](../docs/images/other_trainers.png)"
    return f"## Other trainers\n\n{prose(text)}\n\n{table(header, rows)}\n\n{picture}"


def main() -> None:
    """Trains what has not been trained yet; then draws and reports."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--attempts", type=int, default=50_000)
    parser.add_argument("--trainers", nargs="+", default=list(NAMES), choices=list(NAMES))
    parser.add_argument(
        "--runs", type=Path, default=Path("runs") / "other_trainers", help="keeps the curves"
    )
    parser.add_argument("--write", action="store_true", help="into reports/benchmarks.md")
    asked = parser.parse_args()
    found = {name: trained(name, asked.attempts, asked.runs) for name in asked.trainers}
    if len(found) == len(NAMES):
        chance = by_chance()
        draw({name: each["rows"] for name, each in found.items()}, chance)
        packages = ("mujoco", "jax", "brax", "gymnasium", "stable-baselines3", "torch")
        report(
            "other_trainers",
            section(found, chance, asked.attempts),
            write=asked.write,
            packages=packages,
        )


if __name__ == "__main__":
    main()
