"""Takes trained policies into scenes/checkpoints: weights for acting, learning curve, and a card.

    python scenes/ship_policies.py runs/dining-policy-0 runs/kitchen-normal-0 ...

Each run must have been evaluated, which `python train.py` does at its end.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

from cluttergen_jax.agent.checkpoint import read_record
from cluttergen_jax.training.metrics_log import draw_curve, read_rows

MAX_BYTES = 1_000_000
ROOT = Path(__file__).parent / "checkpoints"


def name_of(record: dict[str, Any]) -> str:
    """POOL-VARIANT."""
    return f"{record['pool']}-{record['variant']}"


def command_of(record: dict[str, Any]) -> str:
    """The command that makes the policy again."""
    words = ["python train.py", f"--pool {record['pool']}", f"--variant {record['variant']}"]
    words += [f"--seed {record['seed']}", f"--num-attempts {record['ppo']['num_attempts']}"]
    if record["preset"] != "cpu":
        words.append(f"--preset {record['preset']}")
    if record["support"] != "table":
        words.append(f"--support {record['support']}")
    if record["placement"]["num_objects"] != 10:
        words.append(f"--num-objects {record['placement']['num_objects']}")
    return " ".join(words)


def card(record: dict[str, Any], rows: list[dict[str, float]]) -> str:
    """What a user should know, in Markdown."""
    found = record["evaluation"]
    size = rows[0]["attempts"]
    seconds = sum(size / row["attempts_per_second"] for row in rows)
    placement = record["placement"]
    versions = ", ".join(f"{name} {number}" for name, number in record["versions"].items())
    success = f"{found['success']:.3f} [{found['low95']:.3f}, {found['high95']:.3f}]"
    return f"""# {name_of(record)}

A placement policy of cluttergen_jax (variant `{record["variant"]}`, preset `{record["preset"]}`).

- For pool `{record["pool"]}`: {placement["num_objects"]} objects on `{record["support"]}`,
  {placement["max_attempts"]} attempts each; on other pools it is untested
- Made by `{command_of(record)}`
- {rows[-1]["attempts"]:,.0f} attempts in {seconds / 60:.0f} minutes, compilation not counted,
  on two cores that other work shared
- Success with the whole last check: {success} of {found["episodes"]} fresh episodes, action {found["action"]}
- Trained with {versions}
- `weights.npz`: what acting needs, half precision; `record.json`: every setting; `curve.png`: its
  learning curve
"""


def ship(run: Path, root: Path = ROOT) -> Path:
    """One run's policy; the folder it went to."""
    record = read_record(run / "policy")
    if "evaluation" not in record:
        raise SystemExit(f"{run} has not been evaluated; the same train command does it")
    folder = root / name_of(record)
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(run / "policy", folder)
    rows, evaluations = (read_rows(run / f"{name}.csv") for name in ("progress", "evaluations"))
    # The run's own curve is called after its folder, which may have any name.
    draw_curve(rows, folder / "curve.png", f"{name_of(record)}-{record['seed']}", evaluations)
    (folder / "README.md").write_text(card(record, rows))
    size = (folder / "weights.npz").stat().st_size
    if size > MAX_BYTES:
        raise SystemExit(f"{folder / 'weights.npz'} has {size:,} bytes; at most {MAX_BYTES:,}")
    return folder


def main() -> None:
    """Ships the runs named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+")
    for run in parser.parse_args().runs:
        print(ship(run))


if __name__ == "__main__":
    sys.exit(main())
