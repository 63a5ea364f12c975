"""What is said of crowds: what was asked, what came of it."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.scene.bank.stats import ClutterTally
from cluttergen_jax.scene.bank.table import CLUTTER, SCHEMA
from tests.helpers.drawing import GREEN, RED
from tests.helpers.recordings import GREEN_AT, RED_AT, TOP


def rows(beside, leaning):
    poses = np.stack([RED_AT, GREEN_AT]).tolist()
    scene = {"is_success": True, "num_placed": 2, "objects": ["red", "green"], "poses": poses}
    scene |= {"index": 0, "verdict": "stable", "drift": 0.0, "is_placed": [True, True]}
    counts = [
        scene | {"num_beside": side, "num_leaning": lean}
        for side, lean in zip(beside, leaning, strict=True)
    ]
    return pa.Table.from_pylist(counts, schema=pa.unify_schemas([SCHEMA, CLUTTER]))


def test_crowds_are_told_beside_what_was_asked():
    bank = SimpleNamespace(
        recipe={"placement": {"crowd": 1.0, "num_objects": 2}},
        path=Path("bank"),
        support=cuboid_table(0.32, 0.24, TOP),
        object={"red": RED, "green": GREEN}.__getitem__,
    )
    tally = ClutterTally(bank)
    tally.add(rows(beside=[1, 1, 0], leaning=[2, 0, 0]))
    found = {each.name: each for each in tally.features()}
    # A pair for two objects; more than asked for is reached as well.
    side = found["side"]
    lean = found["lean"]
    assert (side.asked, side.got, side.within) == pytest.approx((0.5, 1 / 3, 2 / 3))
    assert (lean.asked, lean.got, lean.within) == pytest.approx((0.4, 1 / 3, 1 / 3))
    assert side.line().endswith("asked for 0.5: 66.7% of the scenes reach it")
    highest = max(at[2] + each.half_extents[2] for at, each in ((RED_AT, RED), (GREEN_AT, GREEN)))
    assert found["height"].got == pytest.approx(highest - TOP)


def test_what_nobody_counted_is_not_told():
    bank = SimpleNamespace(recipe={}, path=Path("bank"), object=str, support=None)
    tally = ClutterTally(bank)
    tally.add(rows(beside=[None], leaning=[None]))
    assert not {"side", "lean", "height"} & {each.name for each in tally.features()}
