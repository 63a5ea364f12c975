"""Takes trained checkpoints into scenes/checkpoints or scenes/ablations: weights, a picture, and a card.

    python scenes/ship_policies.py runs/dining-policy-0 runs/kitchen-normal-0 runs/guided-0 ...

A policy must have been evaluated, which `python train.py` does at its end; its picture is the learning curve,
that of `guided` the calibration on families of objects that were held out.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

from cluttergen_jax.learning.policies.embedded import FOR_ANY_POOL
from cluttergen_jax.learning.ppo.checkpoint import read_record
from cluttergen_jax.learning.training.run_logger import draw_curve, read_rows

MAX_BYTES = 1_000_000
MAX_BYTES_FOR_ANY_POOL = 200_000
SCENES = Path(__file__).parent
SHIPPED = ("guided", "policy")
"""Variants that come with the package; those of ablations stay in the repository."""


def name_of(record: dict[str, Any]) -> str:
    """POOL-VARIANT, or the variant alone where it serves every pool."""
    is_for_any = record["variant"] in FOR_ANY_POOL
    return record["variant"] if is_for_any else f"{record['pool']}-{record['variant']}"


def command_of(record: dict[str, Any]) -> str:
    """The command that makes the policy again."""
    words = ["python train.py", f"--pool {record['pool']}", f"--variant {record['variant']}"]
    words += [f"--seed {record['seed']}", f"--num-attempts {record['ppo']['num_attempts']}"]
    if record["preset"] != "cpu":
        words.append(f"--preset {record['preset']}")
    if record.get("encoder_weights"):
        words.append(f"--encoder-weights {record['encoder_weights']}")
    if record["support"] != "table":
        words.append(f"--support {record['support']}")
    if record["placement"]["num_objects"] != 10:
        words.append(f"--num-objects {record['placement']['num_objects']}")
    return " ".join(words)


def card(record: dict[str, Any], rows: list[dict[str, float]]) -> str:
    """What a user should know of a policy, in Markdown."""
    found = record["evaluation"]
    size = rows[0]["attempts"]
    seconds = sum(size / row["attempts_per_second"] for row in rows)
    placement = record["placement"]
    success = f"{found['success']:.3f} [{found['low95']:.3f}, {found['high95']:.3f}]"
    return f"""# {name_of(record)}

A placement policy of cluttergen_jax (variant `{record["variant"]}`, preset `{record["preset"]}`).

- For pool `{record["pool"]}`: {placement["num_objects"]} objects on `{record["support"]}`,
  {placement["max_attempts"]} attempts each; on other pools it is untested
- Made by `{command_of(record)}`
- {rows[-1]["attempts"]:,.0f} attempts in {seconds / 60:.0f} minutes, compilation not counted,
  on two cores that other work shared
- Success with the whole last check: {success} of {found["episodes"]} fresh episodes, action {found["action"]}
- Trained with {_versions(record)}
- `weights.npz`: what acting needs, half precision; `record.json`: every setting; `curve.png`: its
  learning curve
"""


def guided_card(record: dict[str, Any]) -> str:
    """What a user should know of `guided`, in Markdown."""
    config = record["config"]
    command = f"python train.py --variant guided --seed {config['seed']}"
    command += f" --num-attempts {config['num_attempts'] * config['num_rounds']}"
    lines = "\n".join(f"| {name} | {_cells(found)} |" for name, found in record["held_out"].items())
    names = list(
        dict.fromkeys(name for found in record["held_out"].values() for name in _plain(found))
    )
    return f"""# {name_of(record)}

The stability network of cluttergen_jax (variant `guided`): whether an object that is let go at a pose will
stand. It knows no object and no pool, and serves all of them.

- Made by `{command}`
- {record["num_attempts"]:,} attempts in {config["num_rounds"]} rounds, with objects of
  {len(record["families"])} families of the modeller: {", ".join(record["families"])}
- Never seen in training: {len(record["held_out_families"])} whole families
  ({", ".join(record["held_out_families"])}), and all imported objects
- Trained with {_versions(record)}
- `weights.npz`: half precision; `record.json`: every setting; `calibration.png`: what it says of attempts
  with objects of the held-out families, and what became of them

Of those attempts:

| | {" | ".join(names)} |
|---|{"---|" * len(names)}
{lines}
"""


def _plain(found: dict[str, Any]) -> dict[str, float]:
    """The single numbers of a calibration, by name; curves are in the picture."""
    return {
        name.replace("_", " "): value
        for name, value in found.items()
        if isinstance(value, int | float)
    }


def _cells(found: dict[str, Any]) -> str:
    texts = (
        f"{value:,}" if isinstance(value, int) else f"{value:.3f}"
        for value in _plain(found).values()
    )
    return " | ".join(texts)


def _versions(record: dict[str, Any]) -> str:
    return ", ".join(f"{name} {number}" for name, number in record["versions"].items())


def ship(run: Path, scenes: Path = SCENES) -> Path:
    """One run's policy; the folder it went to."""
    record = read_record(run / "policy")
    is_for_any = record["variant"] in FOR_ANY_POOL
    if not is_for_any and "evaluation" not in record:
        raise SystemExit(f"{run} has not been evaluated; the same train command does it")
    size = (run / "policy" / "weights.npz").stat().st_size
    most = MAX_BYTES_FOR_ANY_POOL if is_for_any else MAX_BYTES
    if size > most:
        raise SystemExit(f"{run / 'policy' / 'weights.npz'} has {size:,} bytes; at most {most:,}")
    folder = (
        scenes / ("checkpoints" if record["variant"] in SHIPPED else "ablations") / name_of(record)
    )
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(run / "policy", folder)
    if is_for_any:
        text = guided_card(record)
    else:
        rows, evaluations = (read_rows(run / f"{name}.csv") for name in ("progress", "evaluations"))
        # The run's own curve is called after its folder, which may have any name.
        draw_curve(rows, folder / "curve.png", f"{name_of(record)}-{record['seed']}", evaluations)
        text = card(record, rows)
    (folder / "README.md").write_text(text)
    return folder


def main() -> None:
    """Ships the runs named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    for run in parser.parse_args().runs:
        print(ship(run))


if __name__ == "__main__":
    sys.exit(main())
