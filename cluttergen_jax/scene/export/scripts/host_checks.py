"""What the scripts beside an export ask of their host before they do anything with it."""

import warnings
from importlib.metadata import PackageNotFoundError, version


def check_versions(known, install):
    """Warns of packages of other versions than those that a script was run with.

    Args:
      known: for each package, how the versions begin that it was run with.
      install: the words after `pip install` that bring them.
    """
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
