"""Furniture with doors and drawers is opened to look behind them, and what cannot close is left as it is."""

import numpy as np
import pytest

from cluttergen_jax import import_support
from cluttergen_jax.assets.doors import Doors
from cluttergen_jax.assets.support_file import find_support
from tests.helpers.doors import DRAWER, FLOOR, cupboard_mjcf, cupboard_urdf

pytestmark = pytest.mark.usefixtures("home")


def heights(support):
    return [round(each.position[2], 3) for each in support.surfaces]


@pytest.mark.parametrize(
    "make", [pytest.param(cupboard_urdf, marks=pytest.mark.slow), cupboard_mjcf]
)
def test_doors_and_drawers_are_opened_to_look_behind_them(make, tmp_path, capsys):
    support = import_support(make(tmp_path))
    said = capsys.readouterr().err
    assert "opened to look behind them: 'rail', 'swing'" in said
    # The board on which the drawer runs has no air once it is closed.
    assert "no surface at 0.42 m: once doors and drawers are closed, 0.02 m of air are left" in said
    assert heights(support) == [0.7, DRAWER, FLOOR]
    rail, swing = support.joints
    assert (rail.value, rail.closed) == (pytest.approx(0.3), 0.0)
    assert (swing.value, swing.closed) == (pytest.approx(np.radians(100)), 0.0)
    doors = Doors.of(find_support("cupboard_file"))
    assert heights(doors.closed) == heights(support)
    # Nothing of the closed piece reaches beyond its front.
    lowest = min(box.outline[:, 1].min() for box in doors.closed.boxes)
    assert lowest == pytest.approx(
        min(box.outline[:, 1].min() for box in doors.closed.boxes[:6]), abs=0.03
    )


def test_joints_that_are_asked_for_stay_where_they_are_put(tmp_path, capsys):
    support = import_support(cupboard_urdf(tmp_path), joint=["swing=0"])
    assert "opened" not in capsys.readouterr().err
    assert heights(support) == [0.7]
    assert [joint.closed for joint in support.joints] == [None, None]
    support = import_support(cupboard_urdf(tmp_path), name="ajar", joint=["swing=90"])
    assert FLOOR in heights(support)
    assert [joint.closed for joint in support.joints] == [None, None]


def test_a_door_without_limits_is_named_and_stays_closed(tmp_path, capsys):
    support = import_support(cupboard_urdf(tmp_path, has_limits=False))
    said = capsys.readouterr().err
    assert "not opened, as its file states no limits: 'swing'" in said
    assert "opened to look behind them: 'rail'" in said
    assert heights(support) == [0.7, DRAWER]


def test_a_door_that_hits_the_furniture_is_named_and_nothing_is_opened(tmp_path, capsys):
    support = import_support(cupboard_mjcf(tmp_path, has_post=True))
    said = capsys.readouterr().err
    assert "left as its file has it: door 'swing'" in said
    assert "cannot close: empty as it is, it hits the furniture itself at 5" in said
    assert heights(support) == [0.7]
    assert [joint.closed for joint in support.joints] == [None, None]
