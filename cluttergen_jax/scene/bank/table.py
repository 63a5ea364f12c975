"""Scenes as rows of a table: one row per scene, failures included."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress

import jax
import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.doors import Doors
from cluttergen_jax.physics.doors import door_text
from cluttergen_jax.placement.boxes import spacing_of
from cluttergen_jax.placement.containers import num_contained
from cluttergen_jax.placement.scenes import SceneBatch
from cluttergen_jax.placement.types import Hollows
from cluttergen_jax.types import Verdict

_ADDED = (Verdict.UNSUPPORTED, Verdict.FRAGILE, Verdict.UNRELATED)
COUNTED = (*(Verdict(code) for code in range(int(Verdict.NON_FINITE) + 1)), *_ADDED)
"""Verdicts of attempts."""


def count_column(verdict: Verdict) -> str:
    """The column that counts a scene's attempts of this verdict."""
    return f"num_{verdict.label.replace('-', '_')}"


SCHEMA = pa.schema(
    [
        ("index", pa.int32()),
        ("is_success", pa.bool_()),
        ("is_filled", pa.bool_()),
        ("verdict", pa.string()),
        ("drift", pa.float32()),
        ("num_placed", pa.int32()),
        ("object_index", pa.list_(pa.int32())),
        ("objects", pa.list_(pa.string())),
        ("is_placed", pa.list_(pa.bool_())),
        ("poses", pa.list_(pa.list_(pa.float32(), 7))),
        ("attempts", pa.list_(pa.int32())),
        ("steps", pa.list_(pa.int32())),
        ("rest_steps", pa.list_(pa.int32())),
        ("simulated_steps", pa.int32()),
        *((count_column(verdict), pa.int32()) for verdict in COUNTED),
    ]
)
"""Slots are lists; `poses` are T_world_object, metres and wxyz; `drift` is in metres; `num_stable` and so on
count the scene's attempts by verdict."""

CLUTTER = pa.schema(
    [
        ("levels", pa.list_(pa.int32())),
        ("num_on", pa.int32()),
        ("num_touching", pa.int32()),
        ("near", pa.float32()),
        ("occlusion", pa.float32()),
        ("num_in", pa.int32()),
        ("num_beside", pa.int32()),
        ("num_leaning", pa.int32()),
    ]
)
"""How cluttered a scene is, of what is placed: null in banks of older versions; `num_in` wherever nothing is
asked to be in something; `num_beside` but for piles and crowds, `num_leaning` but for crowds. `levels` has an
entry per slot, -1 where nothing is placed."""

BY_HAND = pa.schema([("seconds", pa.float32())])
"""What banks made by hand have besides: the seconds that a person spent on the scene, pauses left out."""

DOORS = pa.schema(
    [
        ("joints", pa.list_(pa.float32())),
        ("num_door_hits", pa.int32()),
        ("door_hit", pa.string()),
    ]
)
"""What banks have besides whose doors are closed: where all joints of the support are, radians or metres, in
its order; how often a door hit an object or did not close; and the last time, such as `door_left hits mug`,
"" if there was none."""

CERTIFICATE = pa.schema(
    [
        ("residual_speed", pa.float32()),
        ("residual_angular_speed", pa.float32()),
        ("horizon_drift", pa.float32()),
        ("horizon_turn", pa.float32()),
        ("horizon_seconds", pa.float32()),
        ("penetration", pa.float32()),
        ("num_contacts", pa.int32()),
        ("shake", pa.float32()),
        ("shake_x", pa.float32()),
        ("shake_y", pa.float32()),
        ("rests_on", pa.list_(pa.list_(pa.int32(), 2))),
        ("margin", pa.float32()),
        ("margins", pa.list_(pa.float32())),
        ("tilt_1", pa.float32()),
        ("tilt_2", pa.float32()),
        ("tilt_5", pa.float32()),
        ("robust", pa.bool_()),
        ("detectors", pa.list_(pa.string())),
    ]
)
"""What `cluttergen certify` adds: null for scenes that failed. SI units and radians; `rests_on` holds pairs
of `object_index`, who rests and on whom, -1 for the support; `margins` has an entry per slot, null for what
nothing carries."""


@dataclass(frozen=True, eq=False)
class BankRow:
    """One scene as its row has it, to the bit; `scene.bank.scene.read_scenes` makes a `Scene` of it.

    Attributes:
      index: its number in the bank.
      objects: names of the N placed objects in the order of placement.
      poses: f32[N, 7], their world poses, metres, wxyz.
      is_success: every slot is filled and the finished scene stands.
      verdict: the last word on it, in the words of `types.Verdict`.
      drift: metres, the largest movement in the last check.
      joints: where the support's joints are, see `DOORS`; None where no doors are closed.
    """

    index: int
    objects: tuple[str, ...]
    poses: np.ndarray
    is_success: bool
    verdict: str
    drift: float
    joints: tuple[float, ...] | None = None

    def __repr__(self) -> str:
        return f"BankRow(scene {self.index}: {', '.join(self.objects)}; {self.verdict})"


def rows_of(table: pa.Table) -> Iterator[BankRow]:
    """The scenes of some rows, failures included."""
    for row in table.to_pylist():
        yield BankRow(
            index=row["index"],
            objects=tuple(compress(row["objects"], row["is_placed"])),
            poses=np.array(row["poses"], np.float32).reshape(-1, 7)[
                np.array(row["is_placed"], bool)
            ],
            is_success=row["is_success"],
            verdict=row["verdict"],
            drift=row["drift"],
            joints=tuple(row["joints"]) if row.get("joints") is not None else None,
        )


COLUMNS = pa.unify_schemas([SCHEMA, CLUTTER, CERTIFICATE])
"""What every file of rows has; some banks have `BY_HAND` or `DOORS` besides."""


def with_added(rows: pa.Table) -> pa.Table:
    """The rows with those of `COLUMNS` that they lack: in banks of older versions, or before `certify`.

    Nothing was unsupported or fragile then; everything else is null.
    """
    for field in COLUMNS:
        if field.name not in rows.schema.names:
            is_count = field.name in map(count_column, _ADDED)
            values = (
                pa.array(np.zeros(rows.num_rows, np.int32))
                if is_count
                else pa.nulls(rows.num_rows, field.type)
            )
            rows = rows.append_column(field, values)
    return rows


def with_columns_of(before: pa.Table, rows: pa.Table) -> pa.Table:
    """The rows of a block that grew, with what was measured of those of them that were there before.

    Args:
      before: the block as it was stored, its rows the first ones of `rows`.
      rows: the block as it is now; where a row is another one, nothing of it is kept.

    Returns:
      The rows with all columns of both; what was not measured is null.
    """
    number = min(before.num_rows, rows.num_rows)
    old, new = (table.select(SCHEMA.names).slice(0, number).to_pylist() for table in (before, rows))
    is_kept = np.array([one == other for one, other in zip(old, new, strict=True)], bool)
    is_new = np.append(~is_kept, np.ones(rows.num_rows - number, bool))
    places = pa.array(np.arange(rows.num_rows), mask=is_new)
    for field in before.schema:
        if field.name not in SCHEMA.names and field.name not in rows.schema.names:
            rows = rows.append_column(field, before[field.name].combine_chunks().take(places))
    return rows


def schema_of(rows: pa.Table) -> pa.Schema:
    """The columns that rows of a bank have, without unknown ones."""
    some = [each for each in (BY_HAND, DOORS) if set(each.names) <= set(rows.schema.names)]
    return pa.unify_schemas([SCHEMA, CLUTTER, *some, CERTIFICATE])


def is_certified(rows: pa.Table, seconds: float) -> bool:
    """Whether all scenes that succeeded have their certificate, drift over so many seconds in it."""
    horizons = rows.filter(rows["is_success"])["horizon_seconds"].to_pylist()
    return all(each in (np.float32(seconds), seconds) for each in horizons)


def table_of(
    indices: np.ndarray,
    scenes: SceneBatch,
    names: Sequence[str],
    half_extents: np.ndarray,
    numbers: np.ndarray | None = None,
    hollows: Hollows | None = None,
    doors: Doors | None = None,
) -> pa.Table:
    """The rows of a block of scenes with one leading axis.

    Args:
      names: of the world's K objects; half_extents: f32[K, 3] of their boxes, metres.
      numbers: i32[K], of these objects among those that the bank's record names; as they come if None.
      hollows: of these objects, if they are known.
      doors: that were closed, if any were.
    """
    numbers = np.arange(len(names)) if numbers is None else numbers
    half = half_extents[np.maximum(scenes.object_index, 0)]
    near, hidden = jax.device_get(_spacing(half, scenes.poses, scenes.is_placed))
    inside = None
    if hollows is not None:
        own = jax.device_get(hollows.take(np.maximum(scenes.object_index, 0)))
        inside = jax.device_get(_num_contained(half, own, scenes.poses, scenes.is_placed))
    rows = [
        _row(int(index), scenes, place, names, numbers)
        | {"near": float(near[place]), "occlusion": float(hidden[place])}
        | {"num_in": None if inside is None else int(inside[place])}
        | ({} if doors is None else _closing(doors, scenes, place, names))
        for place, index in enumerate(indices)
    ]
    more = [] if doors is None else [DOORS]
    return pa.Table.from_pylist(rows, schema=pa.unify_schemas([SCHEMA, CLUTTER, *more]))


_spacing, _num_contained = (jax.jit(jax.vmap(each)) for each in (spacing_of, num_contained))


def _row(
    index: int, scenes: SceneBatch, place: int, names: Sequence[str], numbers: np.ndarray
) -> dict[str, object]:
    slots = np.flatnonzero(scenes.object_index[place] >= 0)
    object_index = scenes.object_index[place][slots]
    counts = scenes.counts.verdicts[place]
    return {
        "index": index,
        "is_success": bool(scenes.is_success[place]),
        "is_filled": bool(scenes.is_filled[place]),
        "verdict": Verdict(int(scenes.verdict[place])).label,
        "drift": float(scenes.drift[place]),
        "num_placed": int(scenes.is_placed[place].sum()),
        "object_index": numbers[object_index].tolist(),
        "objects": [names[each] for each in object_index],
        "is_placed": scenes.is_placed[place][slots].tolist(),
        "poses": scenes.poses[place][slots].tolist(),
        "attempts": scenes.counts.attempts[place][slots].tolist(),
        "steps": scenes.counts.steps[place][slots].tolist(),
        "rest_steps": scenes.counts.rest_steps[place][slots].tolist(),
        "simulated_steps": int(scenes.counts.simulated_steps[place]),
        **_stacking(scenes, place, slots),
        # What is not asked for, such as a margin, is not counted.
        **{count_column(v): int(counts[v]) if v < len(counts) else 0 for v in COUNTED},
    }


def _closing(
    doors: Doors, scenes: SceneBatch, place: int, names: Sequence[str]
) -> dict[str, object]:
    record = scenes.doors
    assert record is not None
    values = [joint.value for joint in doors.open.joints]
    is_closed = bool(scenes.is_success[place])
    for number, travel in zip(doors.numbers, record.travel[place].tolist(), strict=True):
        values[number] = doors.closed.joints[number].value if is_closed else values[number] + travel
    hit = int(record.hit[place])
    return {
        "joints": values,
        "num_door_hits": int(record.num_hits[place]),
        "door_hit": door_text(doors.names, int(record.door[place]), hit, names),
    }


def _stacking(scenes: SceneBatch, place: int, slots: np.ndarray) -> dict[str, object]:
    if scenes.level is None or scenes.num_touching is None:
        return dict.fromkeys(("levels", "num_on", "num_touching"))
    levels = scenes.level[place][slots]
    counted = {name: getattr(scenes, name) for name in ("num_beside", "num_leaning")}
    return {
        **{name: None if each is None else int(each[place]) for name, each in counted.items()},
        "levels": levels.tolist(),
        "num_on": int((levels > 0).sum()),
        "num_touching": int(scenes.num_touching[place]),
    }
