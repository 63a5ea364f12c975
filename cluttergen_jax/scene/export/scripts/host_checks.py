"""What the scripts beside an export ask of their host before they use it, and of a scene's number."""

import operator
import sys
import warnings
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from itertools import groupby


def check_versions(known, install, modules):
    """Refuses a host that is not installed (ImportError); warns of versions that a script was not run with.

    Args:
      known: for each package, how the versions begin that it was run with.
      install: the words after `pip install` that bring them.
      modules: that the script imports.
    """
    missing = [name for name in modules if name not in sys.modules and find_spec(name) is None]
    if missing:
        raise ImportError(f"{', '.join(missing)} not installed. Try: pip install {install}")
    for package, beginnings in known.items():
        try:
            found = version(package)
        except PackageNotFoundError:
            # Also a folder of sources, which has no number.
            found = "of no known version"
        if not found.startswith(beginnings):
            words = ", ".join(each.rstrip(".") for each in beginnings)
            warnings.warn(
                f"{package} {found}; known: {words}. Try: pip install {install}", stacklevel=3
            )


def check_path(root):
    """Refuses an export in a folder called robosuite, which robosuite takes for its own (ValueError)."""
    if "robosuite" in root.parts:
        raise ValueError(
            f"{root} has a folder called 'robosuite', after which robosuite looks for files of its own; "
            "rename it or move the export"
        )


def scene_number(number, known, root):
    """The number of a scene, also given as text.

    Args:
      number: what a user gave. known: the numbers that there are, sorted. root: the export.

    Raises:
      ValueError: there is no such scene.
    """
    try:
        found = int(number) if isinstance(number, str) else operator.index(number)
    except (TypeError, ValueError):
        found = None
    if found not in known:
        raise ValueError(f"no scene {number!r} in {root}; there are {_ranges(known)}")
    return found


def _ranges(numbers, most=8):
    """Sorted numbers in words: "0 to 3, 7"."""
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(numbers), lambda pair: pair[1] - pair[0])
    ]
    words = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
    more = ", ..." if len(words) > most else ""
    return ", ".join(words[:most]) + more or "none"
