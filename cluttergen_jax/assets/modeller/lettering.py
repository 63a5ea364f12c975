"""Raised block letters, for titles, labels and displays."""

from __future__ import annotations

import itertools

from manifold3d import Manifold

from cluttergen_jax.assets.modeller import solids as cad

# Five rows of each letter, top to bottom; a mark is a filled cell.
_GLYPHS = {
    "A": " ## |#  #|####|#  #|#  #",
    "B": "### |#  #|### |#  #|### ",
    "C": " ###|#   |#   |#   | ###",
    "D": "### |#  #|#  #|#  #|### ",
    "E": "####|#   |### |#   |####",
    "F": "####|#   |### |#   |#   ",
    "I": "###| # | # | # |###",
    "L": "#   |#   |#   |#   |####",
    "N": "#  #|## #|# ##|#  #|#  #",
    "O": " ## |#  #|#  #|#  #| ## ",
    "P": "### |#  #|### |#   |#   ",
    "S": " ###|#   | ## |   #|### ",
    "T": "#####|  #  |  #  |  #  |  #  ",
    "U": "#  #|#  #|#  #|#  #| ## ",
    "X": "#   #| # # |  #  | # # |#   #",
    "0": "####|#  #|#  #|#  #|####",
    "1": " # |## | # | # |###",
    "2": "### |   #| ## |#   |####",
    "3": "### |   #| ## |   #|### ",
    "4": "#  #|#  #|####|   #|   #",
    "5": "####|#   |### |   #|### ",
    "7": "####|   #|  # | #  | #  ",
    "8": "####|#  #|####|#  #|####",
    "9": "####|#  #|####|   #|####",
    ":": " |#| |#| ",
    " ": "  |  |  |  |  ",
}


def lettering(text: str, height: float, relief: float = 0.0006) -> Manifold:
    """Words in relief on the plane z = 0, read along x with y up, centred on the origin.

    Args:
      text: of letters that are drawn above.
      height: metres, of a letter.
      relief: metres; as much again is sunk below the plane, to join what it stands on.
    """
    cell = height / 5
    bars = []
    pen = 0
    for glyph in (_GLYPHS[letter].split("|") for letter in text):
        for row, line in enumerate(glyph):
            bars += [
                # Cells reach a little over their neighbours, so that letters are joined at corners too.
                cad.box(
                    (cell * (len(run) + 0.1), cell * 1.1, 2 * relief),
                    (cell * (pen + start + len(run) / 2), cell * (4.5 - row)),
                    -relief,
                )
                for start, run in _runs(line)
            ]
        pen += len(glyph[0]) + 1
    return cad.union(*bars).translate((-cell * (pen - 1) / 2, -height / 2, 0.0))


def _runs(line: str) -> list[tuple[int, str]]:
    """The filled stretches of a row: where each starts, and its cells."""
    runs = []
    start = 0
    for mark, cells in itertools.groupby(line):
        run = "".join(cells)
        if mark == "#":
            runs.append((start, run))
        start += len(run)
    return runs
