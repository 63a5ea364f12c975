"""Writes docs/results.md from the JSON files in docs/results, and docs/missed.md below them.

python docs/make_results.py                          from what is there
python docs/make_results.py out/paper out/extended   after taking over what those suites made
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from cluttergen_jax.evaluation.report import document, read_results, shown_pictures

HERE = Path(__file__).parent
FOLDER, PAGE = HERE / "results", HERE / "results.md"
NOTES = HERE / "missed.md"


def take_over(folder: Path) -> None:
    """Copies the studies of a suite's folder, and the pictures that the page shows."""
    for result in read_results(folder):
        FOLDER.mkdir(exist_ok=True)
        for name in (f"{result['name']}.json", *shown_pictures(result)):
            shutil.copyfile(folder / name, FOLDER / name)


def main() -> None:
    """Writes the page."""
    for folder in sys.argv[1:]:
        take_over(Path(folder))
    results = read_results(FOLDER)
    PAGE.write_text(document(results, NOTES.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"{PAGE}: {len(results)} studies")


if __name__ == "__main__":
    main()
