"""Scenes of banks as the programs beyond generation take them, and refusals of those that they cannot use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cluttergen_jax.assets import SupportAsset
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.scene import Bank, read_bank


class StableScenes(NamedTuple):
    """The S scenes of a bank that are stable, with N slots.

    Attributes:
      number: i[S], in the bank, which has `num_scenes`. method: that made them.
      objects: i[S, N], in the order of placement, -1 is padding.
      poses: f64[S, N, 7], T_world_object, metres, wxyz.
    """

    number: np.ndarray
    objects: np.ndarray
    poses: np.ndarray
    num_scenes: int
    method: str

    @classmethod
    def read(cls, bank: Bank) -> StableScenes:
        """All of a bank. Raises BankError: there is none."""
        columns = ("index", "is_success", "object_index", "poses")
        rows = [
            row for table in bank.tables(columns) for row in table.to_pylist() if row["is_success"]
        ]
        if not rows:
            raise BankError(
                f"{bank.path}: none of its scenes stands", "one that does or more", "more scenes"
            )
        number, objects, poses = (
            np.array([row[name] for row in rows]) for name in (columns[0], *columns[2:])
        )
        method = str(bank.record["recipe"]["method"])
        return cls(number, objects, poses.astype(np.float64), bank.num_scenes, method)

    def row(self, scene: int) -> int:
        """The row of a scene, or of the last stable one before it, or the first row.

        It does not depend on later scenes, so a bank may be continued.
        """
        return max(0, int(np.searchsorted(self.number, scene % self.num_scenes, side="right")) - 1)


def bank_or_made(
    bank: str | Path | None, make: Callable[[], Bank], names: str, given: Sequence[object]
) -> Bank:
    """The bank in a folder, or one made along, as it is given; names: of what is given for that.

    Raises:
      ConfigError: there is a bank, and something of one that would be made is given as well.
    """
    if bank is None:
        return make()
    for name, value in zip(names.split(), given, strict=True):
        if value is not None:
            raise ConfigError(
                f"`{name}` together with `bank`", "one or the other", f"leaving out `{name}`"
            )
    return read_bank(bank)


def check_upright(poses: object, what: str) -> None:
    """Refuses scenes whose objects were not released upright.

    Args:
      poses: `SceneSpec.poses` of the scenes; what: who has no use for them.

    Raises:
      ConfigError: they were not.
    """
    if poses != "upright":
        raise ConfigError(
            f"scenes of poses {poses!r} for {what}",
            "scenes of upright objects: it proposes a position and a turn about the vertical",
            "a bank of `cluttergen generate` with --poses upright",
        )


def check_one_level(support: SupportAsset, what: str) -> None:
    """Refuses scenes on a slope, or on several surfaces of a support.

    Args:
      support: with the surfaces that objects are asked for on; what: who has no use for them.

    Raises:
      ConfigError: they are on such.
    """
    asked = [surface for surface, _ in support.asked]
    if len(asked) > 1:
        names = ", ".join(each.name for each in asked)
        raise ConfigError(
            f"scenes on {len(asked)} surfaces of support {support.name!r} ({names}) for {what}",
            "scenes on one level surface",
            f"scenes of `cluttergen generate` with --surface {asked[0].name}",
        )
    if not asked[0].is_level:
        raise ConfigError(
            f"surface {asked[0].name!r} of support {support.name!r}, which slopes by "
            f"{np.degrees(asked[0].tilt):.3g} degrees, for {what}",
            "a level surface",
            "another support (`cluttergen list`)",
        )


def poses_of(bank: Bank) -> object:
    """`SceneSpec.poses` of a bank's scenes."""
    return bank.recipe.get("placement", {}).get("poses", "upright")
