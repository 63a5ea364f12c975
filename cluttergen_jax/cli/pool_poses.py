"""`cluttergen pool pose`: the poses of an object, and another one for it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.importing.poses import Pose, pool_poses, set_pose
from cluttergen_jax.tables import aligned_table

_HEADER = ("pose", "mm tall", "degrees from now", "tips over at", "of random falls")


def pose(words: Sequence[str]) -> None:
    """Lists an object's poses, after it was put into another if one is asked for.

    Args:
      words: pool, object, and the number of a pose if the object is to be put into it.

    Raises:
      ConfigError: there are fewer words or more, or the last is no number.
    """
    if len(words) not in (2, 3) or not all(word.isdecimal() for word in words[2:]):
        raise ConfigError(
            f"pool pose {' '.join(words)}",
            "a pool, one of its objects, and the number of a pose (0 or more) to change it",
            "cluttergen pool pose POOL OBJECT",
        )
    pool, name, *number = words
    if number:
        asset = set_pose(pool, name, int(number[0]))
        tall, rate = 2000 * asset.half_extents[2], 100 * (asset.quality.solo_rate or 0.0)
        print(f"{name} now stands so: {tall:.0f} mm tall, stable in {rate:.1f} % of trials")
        print("\n".join(f"  ! {flag}" for flag in asset.flags), end="\n" if asset.flags else "")
    print(aligned_table(_HEADER, [_row(k, each) for k, each in enumerate(pool_poses(pool, name))]))


def _row(number: int, each: Pose) -> tuple[str, ...]:
    turn = math.degrees(math.acos(max(-1.0, min(1.0, each.up[2])))) if number else 0.0
    return (
        str(number) if number else "0 (now)",
        f"{1000 * each.height:.0f}",
        f"{turn:.0f}",
        f"{each.tip:.0f}",
        f"{100 * each.likelihood:.0f} %",
    )
