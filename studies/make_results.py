"""Writes reports/results.md and the tables of the READMEs from the JSON files in reports/results.

Below the page stands reports/missed.md.

python -m studies.make_results                          from what is there
python -m studies.make_results out/paper out/extended   after taking over what those suites made
python -m studies.make_results --keep-rows out/paper    the same, and rows that were not made again stay

Of a suite that had episodes of the arm their rows come too, to reports/results/episodes. Copied from there
into the folder of `evaluate --out`, they are resumed by that command.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from cluttergen_jax.evaluation.store import json_bytes
from cluttergen_jax.files import write_atomically
from studies.pages import write_pages
from studies.report import (
    document,
    read_results,
    redraw,
    shown_pictures,
    with_earlier_rows,
)

HERE = Path(__file__).parents[1] / "reports"
FOLDER = HERE / "results"
PAGE = HERE / "results.md"
NOTES = HERE / "missed.md"


def take_over(folder: Path, keep_rows: bool) -> None:
    """Copies the studies of a suite's folder, and the pictures that the page shows."""
    FOLDER.mkdir(exist_ok=True)
    earlier = {result["name"]: result for result in read_results(FOLDER)} if keep_rows else {}
    for result in read_results(folder):
        name = result["name"]
        result = with_earlier_rows(result, earlier[name]) if name in earlier else result
        write_atomically(FOLDER / f"{name}.json", json_bytes(result))
        with TemporaryDirectory() as drawn:
            redrawn = redraw(result, Path(drawn)) if name in earlier else []
            for picture in shown_pictures(result):
                shutil.copyfile(
                    Path(drawn if picture in redrawn else folder) / picture, FOLDER / picture
                )
    for rows in folder.glob("episodes/**/*.jsonl"):
        write_atomically(FOLDER / rows.relative_to(folder), rows.read_bytes())


def main() -> None:
    """Writes the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--keep-rows", action="store_true")
    asked = parser.parse_args()
    for folder in asked.folders:
        take_over(folder, asked.keep_rows)
    results = read_results(FOLDER)
    PAGE.write_text(document(results, NOTES.read_text(encoding="utf-8")), encoding="utf-8")
    write_pages(results)
    print(f"{PAGE}: {len(results)} studies")


if __name__ == "__main__":
    main()
