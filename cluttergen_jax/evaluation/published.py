"""The paper's own figures, as data: Jia and Chen, "ClutterGen", CoRL 2024.

Ten objects on a cuboid table of 0.60 x 0.70 x 0.70 m unless said otherwise. Success is the paper's looser
count: only the object in hand is judged, the others are put back by hand. Stable steps are those of all
attempts of an object added up.
"""

from __future__ import annotations

SOURCE = "Jia and Chen, ClutterGen, CoRL 2024"

GROUP_OF_POOL = {
    "dining": ("1, dining", "YCB scans"),
    "study": ("2, studying", "PartNet-Mobility and Objaverse"),
    "office": ("3, office", "PartNet-Mobility and Objaverse"),
    "kitchen": ("4, kitchen", "PartNet-Mobility and Objaverse"),
    "household": ("5, real", "own scans"),
}
"""The paper's group that each embedded pool stands for, and where its objects came from."""

IMPORTED = "paper_"
"""How names of pools begin that were imported from the authors' own files, such as `paper_dining`."""

TWINS = {"beta": "beta", "policy": "beta"}
"""Methods that are the paper's ClutterGen: with its own head, and with the one that a preset gives it."""

TABLE_1: dict[str, dict[str, tuple[float, int]]] = {
    "random": {
        "dining": (0.005, 169),
        "study": (0.0, 290),
        "office": (0.0, 171),
        "kitchen": (0.02, 214),
        "household": (0.005, 176),
    },
    "open_loop": {
        "dining": (0.212, 139),
        "study": (0.145, 207),
        "office": (0.086, 171),
        "kitchen": (0.232, 165),
        "household": (0.251, 135),
    },
    "short_memory": {
        "dining": (0.359, 102),
        "study": (0.414, 111),
        "office": (0.364, 107),
        "kitchen": (0.517, 98),
        "household": (0.602, 83),
    },
    "normal": {
        "dining": (0.925, 74),
        "study": (0.833, 85),
        "office": (0.951, 56),
        "kitchen": (0.969, 51),
        "household": (0.989, 44),
    },
    "beta": {
        "dining": (0.912, 89),
        "study": (0.874, 71),
        "office": (0.963, 60),
        "kitchen": (0.973, 50),
        "household": (0.988, 46),
    },
}
"""Success rate and stable steps by method and pool (table 1); `beta` is its ClutterGen."""

TABLE_2 = {
    "none": 0.99,
    "translation": 0.89,
    "rotation": 0.92,
    "shrinkage": 0.76,
    "expansion": 0.93,
    "all": 0.85,
}
"""Success under changes of the queried region: group 5, a table of 1.40 x 1.40 x 0.70 m, 500 episodes."""

FURNITURE = 0.70
"""Success over ten furniture tables and all groups, 50 episodes each."""

OBJECTS = 10
"""Of every scene."""

BUDGET = 2_500_000
"""Environment steps of each training run."""

LEARNING_ATTEMPTS = 2_300_000
LEARNING_SUCCESS = 0.85
"""Every group is above this success after so many attempts."""

ATTEMPTS_SENTENCE = "more attempts help up to 5; two or fewer hurt"
"""What the paper says of the maximum number of attempts."""


def table_1(method: str, pool: str) -> tuple[float, int] | None:
    """Success and stable steps of table 1 that a row stands beside; None if there are none.

    Args:
      pool: an embedded one, or the same name after `IMPORTED`.
    """
    return TABLE_1.get(TWINS.get(method, method), {}).get(pool.removeprefix(IMPORTED))
