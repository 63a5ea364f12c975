"""Makes the picture of docs/guide/gpu.md from a table of reports/benchmarks.md: python docs/make_gpu.py."""

import re
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
REPORT = HERE.parent / "reports" / "benchmarks.md"
COLOURS = {"native": "#8a94a6", "warp": "#2b7a4b"}
NAMES = {
    "native": "native MuJoCo, 16 cores of a Xeon",
    "warp": "MuJoCo Warp, one H100",
}


def attempts_a_second() -> dict[str, dict[int, float]]:
    """Attempts judged in a second, by engine and by scenes side by side."""
    text = REPORT.read_text(encoding="utf-8").split("## GPU")[1].split("### steps")[1]
    found: dict[str, dict[int, float]] = {}
    for engine, batch, rate in re.findall(r"^\| (\w+), (\d+) \| ([\d,]+) \|", text, re.M):
        found.setdefault(engine, {}).setdefault(int(batch), float(rate.replace(",", "")))
    return found


def main() -> None:
    """Draws the bars."""
    figure, axes = plt.subplots(figsize=(8, 3.2), layout="constrained")
    rates = attempts_a_second()
    width = 0.8 / len(rates)
    for place, (engine, by_batch) in enumerate(rates.items()):
        left = [index + (place - (len(rates) - 1) / 2) * width for index in range(len(by_batch))]
        bars = axes.bar(left, by_batch.values(), width, color=COLOURS[engine], label=NAMES[engine])
        axes.bar_label(bars, fmt="{:,.0f}", padding=2, fontsize=9)
    axes.set_xticks(range(len(by_batch)), [f"{batch:,}" for batch in by_batch])
    axes.set_xlabel("scenes side by side")
    axes.set_ylabel("attempts a second")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(HERE / "images" / "gpu.png", dpi=120)


if __name__ == "__main__":
    main()
