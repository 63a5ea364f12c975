"""Doors of supports: where they and what they carry are once joints have moved."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.door_sweep import check_empty
from cluttergen_jax.assets.doors import (
    Doors,
    are_closed,
    are_to_be_closed,
    carriers_of,
    moves_of,
    opened_value,
    with_doors_open,
    with_joints_at,
)
from cluttergen_jax.assets.shape import Joint
from cluttergen_jax.assets.support_file import (
    find_support,
    read_support,
    support_hash,
    write_support,
)
from cluttergen_jax.errors import ConfigError


@pytest.fixture(scope="module")
def cupboard():
    return find_support("cupboard")


def test_joints_move_as_in_mujoco():
    rng = np.random.default_rng(0)
    joints = []
    spec = mujoco.MjSpec()
    above = spec.worldbody
    for number, kind in enumerate(("hinge", "slide", "hinge")):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        anchor = rng.normal(size=3)
        joints.append(Joint(f"j{number}", kind, tuple(anchor), tuple(axis), 0.0, parent=number - 1))
        above = above.add_body(name=f"b{number}", mass=1.0, inertia=(1, 1, 1))
        kinds = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
        above.add_joint(type=kinds[kind], pos=anchor, axis=axis)
    model = spec.compile()
    data = mujoco.MjData(model)
    travel = rng.normal(size=(4, 3))
    moves = moves_of(joints, travel)
    for row, T in zip(travel, moves, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for number in range(3):
            body = model.body(f"b{number}").id
            np.testing.assert_allclose(T[number, :3, :3].ravel(), data.xmat[body], atol=1e-12)
            np.testing.assert_allclose(T[number, :3, 3], data.xpos[body], atol=1e-12)


def test_closing_and_opening_again_changes_nothing(cupboard):
    doors = Doors.of(cupboard)
    assert doors.names == ("drawer", "door_left", "door_right")
    again = with_joints_at(
        doors.closed, {number: cupboard.joints[number].value for number in doors.numbers}
    )
    for one, other in zip(again.boxes, cupboard.boxes, strict=True):
        np.testing.assert_allclose(one.center, other.center, atol=1e-9)
        np.testing.assert_allclose(one.outline, other.outline, atol=1e-9)
    for one, other in zip(again.pieces, cupboard.pieces, strict=True):
        np.testing.assert_allclose(one.mesh.vertices, other.mesh.vertices, atol=1e-9)
    for one, other in zip(again.joints, cupboard.joints, strict=True):
        np.testing.assert_allclose(one.anchor, other.anchor, atol=1e-9)
        np.testing.assert_allclose(one.axis, other.axis, atol=1e-9)
        assert one.value == pytest.approx(other.value)


def test_a_drawer_takes_its_surface_along_and_closed_doors_shut_the_front(cupboard):
    doors = Doors.of(cupboard)
    by_name = dict(
        zip([each.name for each in cupboard.surfaces], carriers_of(cupboard), strict=True)
    )
    assert by_name == {"shelf_1": -1, "shelf_2": -1, "drawer": 0, "top": -1}
    before, after = (
        next(each for each in support.surfaces if each.name == "drawer")
        for support in (doors.open, doors.closed)
    )
    assert after.region.center[1] - before.region.center[1] == pytest.approx(0.322)
    # Nothing may be taller than what fits once it is closed.
    assert before.free_height == pytest.approx(after.free_height)
    assert before.free_height < 0.14
    front = min(box.mesh.bounds[0, 1] for box in doors.closed.boxes[14:])
    assert front > -0.26
    assert min(box.mesh.bounds[0, 1] for box in doors.open.boxes[14:]) < -0.5
    check_empty(doors)


def test_what_is_to_be_closed_is_kept_on_disk(cupboard, tmp_path):
    assert are_to_be_closed(cupboard)
    assert not are_closed(cupboard)
    doors = Doors.of(cupboard)
    for name, support in (("open", doors.open), ("closed", doors.closed)):
        again = read_support(write_support(tmp_path / name, support))
        assert are_to_be_closed(again) == (name == "open")
        assert are_closed(again) == (name == "closed")
        assert [each.closed for each in again.joints] == [0.0, 0.0, 0.0]
    assert Doors.of(doors.closed) is None
    values = [joint.value for joint in with_doors_open(doors.closed).joints]
    assert values == pytest.approx([joint.value for joint in cupboard.joints])


def test_a_door_without_limits_and_a_support_without_doors_are_named(cupboard):
    joints = tuple(replace(each, closed=None) for each in cupboard.joints)
    assert Doors.of(replace(cupboard, joints=joints)).travel == pytest.approx(
        Doors.of(cupboard).travel
    )
    endless = (*joints[:2], replace(joints[2], range=None))
    assert opened_value(endless[2]) is None
    with pytest.raises(ConfigError, match=r"'door_right'.*states no limits"):
        Doors.of(replace(cupboard, joints=endless))
    with pytest.raises(ConfigError, match="'table', which has no joints"):
        Doors.of(find_support("table"))
    with pytest.raises(ConfigError, match="which has none that scenes close"):
        with_doors_open(find_support("bookcase"))


def test_a_door_that_hits_the_furniture_is_named(cupboard):
    # As high as the drawer, so that both are in each other's way.
    box = cupboard.boxes[14]
    tall = replace(box, center=(*box.center[:2], 0.6), half_extents=(*box.half_extents[:2], 0.25))
    boxes = (*cupboard.boxes[:14], tall, *cupboard.boxes[15:])
    jammed = replace(cupboard, boxes=boxes)
    with pytest.raises(ConfigError, match=r"door 'door_left'.*cannot close: .*hits door 'drawer'"):
        check_empty(Doors.of(jammed))


def test_a_support_has_the_same_digest_before_and_after_disk(cupboard, tmp_path):
    # Sums of limits that are no binary fractions.
    joints = tuple(
        replace(joint, closed=-0.044, range=(-0.044, joint.value)) for joint in cupboard.joints
    )
    for support in (
        replace(cupboard, joints=joints),
        Doors.of(replace(cupboard, joints=joints)).closed,
    ):
        folder = write_support(tmp_path / str(are_closed(support)), support)
        assert support_hash(read_support(folder)) == support_hash(support)
