"""What an import left out as no objects for a table, in words: by reason, and how to have it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cluttergen_jax.importing.table_top import LeftOut

_MOST_NAMED = 8
"""So many of what was left out for one reason are named; `ImportReport.left_out` has them all."""
_MANY_FILES = 3


def left_out_text(left_out: Sequence[LeftOut]) -> str:
    """One block, or nothing; options are called as the arguments of `import_pool`."""
    if not left_out:
        return ""
    lines = [f"{len(left_out)} left out, as no objects for a table:"]
    for reason in dict.fromkeys(each.reason for each in left_out):
        lines.append(f"  {reason}: {_named([each for each in left_out if each.reason == reason])}")
    one = f"[{left_out[0].name!r}] take = true"
    return "\n".join([*lines, f"  (`take_all` takes them all; objects.toml takes one of them: {one})", ""])


def _named(group: Sequence[LeftOut]) -> str:
    """The first few by name; bodies that many files have, once."""
    bodies = [each.name.rpartition("#")[2] for each in group]
    files = Counter(bodies)
    told = {}
    for each, body in zip(group, bodies, strict=True):
        if files[body] >= _MANY_FILES and body != each.name and not body.isdigit():
            told[body] = f"{body} in {files[body]} files"
        else:
            told[each.name] = each.name + (f" ({each.detail})" if each.detail else "")
    names = list(told.values())
    more = [f"{len(names) - _MOST_NAMED} more"] if len(names) > _MOST_NAMED else []
    return ", ".join([*names[:_MOST_NAMED], *more])
