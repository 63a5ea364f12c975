"""Broken layouts made stable."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cluttergen_jax.api.text import scene_numbers
from cluttergen_jax.kept_folder import hold_file
from cluttergen_jax.numerics import with_kept_programs

if TYPE_CHECKING:
    from cluttergen_jax.generation.repair import RepairReport


@with_kept_programs
def repair(
    source: str | Path,
    out: str | Path = "out/repaired",
    *,
    pool: str | None = None,
    support: str | None = None,
    scenes: Sequence[int] | str | None = None,
    max_shift: float = 0.05,
    max_turn_deg: float = 45.0,
    overwrite: bool = False,
) -> RepairReport:
    """Makes a broken layout stable with little motion: noisy poses, those of a language model, old starts.

    What is stable is left as it is. Of anything else each object, from the lowest up, is lifted or lowered to
    first contact and let go, or moved to the nearest place where it is stable; what lies on what is kept. The
    result passes the final check of `generate`. What cannot be repaired is named, and nothing is left out.

    Args:
      source: a bank or a scene of it (BANK:INDEX), failed scenes included; a JSON file; or a folder of JSON
        files. Such a file has pool, support, unit (m if not given, cm, mm), and objects, each with a name,
        the pool's name for it as asset if that is another, position (z up, from the floor below the
        support's centre) and one of quaternion_wxyz, quaternion_xyzw, rpy_deg, rpy (radians), yaw_deg and
        yaw (radians); scenes of `cluttergen export` are such files. Other keys are refused.
      out: a bank, or for a single layout also a JSON file.
      pool: of JSON files that name none, or in place of what they name.
      support: likewise.
      scenes: of a bank, numbers such as 0,3,7 or 0-9; all if not given. In Python also a list.
      max_shift: metres by which an object may be moved, 0.5 at most.
      max_turn_deg: degrees by which it may be turned.
      overwrite: begin anew if the folder holds another bank; replace a JSON file.

    Returns:
      What moved by how much; printed, a summary, and what could not be repaired.

    Raises:
      ConfigError: a file is no layout, layouts are of several pools or supports, or a limit is out of range.
      BankError: there is no such bank or scene, or `out` cannot be written.
      PoolError: there is no such pool, object or support.
    """
    from cluttergen_jax.generation.repair import read_layouts, repair_layouts
    from cluttergen_jax.placement.repair import RepairConfig

    limits = RepairConfig(max_shift, max_turn_deg)
    # A bank is held by who writes it.
    with hold_file(out if Path(out).suffix == ".json" else None):
        given = read_layouts(source, pool, support, scene_numbers(scenes))
        return repair_layouts(given, Path(out), limits, overwrite)
