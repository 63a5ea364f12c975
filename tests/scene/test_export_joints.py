"""Furniture with drawers and doors: what moves is known from the file, and can move in an export."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.support_file import read_support, support_hash, write_support
from cluttergen_jax.errors import ConfigError, PoolError
from cluttergen_jax.importing.readers import ReadOptions, find_sources, read_shape
from cluttergen_jax.importing.supports import estimates_of, support_with_notes, with_joints
from cluttergen_jax.scene.export import export_scenes
from cluttergen_jax.scene.export.formats import find_format

OPEN = 0.2
WITH_JOINTS = find_format("mjcf", joints=True)
AJAR = 30.0
BOARDS = {
    "carcass": [
        ("0 0 0.01", "0.5 0.4 0.02"),
        ("0 0 0.59", "0.5 0.4 0.02"),
        ("-0.24 0 0.3", "0.02 0.4 0.56"),
        ("0.24 0 0.3", "0.02 0.4 0.56"),
        ("0 0.19 0.3", "0.46 0.02 0.56"),
    ],
    "drawer": [
        ("0 0 0.005", "0.44 0.36 0.01"),
        ("0 -0.175 0.06", "0.44 0.01 0.1"),
        ("0 0.175 0.06", "0.44 0.01 0.1"),
        ("-0.215 0 0.06", "0.01 0.34 0.1"),
        ("0.215 0 0.06", "0.01 0.34 0.1"),
    ],
    "door": [("0.22 0 0.12", "0.44 0.01 0.24")],
    "knob": [("0 -0.02 0", "0.03 0.03 0.03")],
}
JOINTS = """
<joint name="rail" type="prismatic"><parent link="carcass"/><child link="drawer"/>
  <origin xyz="0 0 0.4"/><axis xyz="0 -1 0"/><limit lower="0" upper="0.3"/></joint>
<joint name="hinge" type="revolute"><parent link="carcass"/><child link="door"/>
  <origin xyz="-0.22 -0.19 0.06"/><axis xyz="0 0 -1"/><limit lower="0" upper="1.5"/></joint>
<joint name="lock" type="revolute"><parent link="door"/><child link="knob"/>
  <origin xyz="0.4 0 0.12"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>
"""
IN_MJCF = """
<mujoco><worldbody><body name="carcass">{carcass}
  <body name="drawer" pos="0 0 0.4">
    <joint name="rail" type="slide" axis="0 -1 0" range="0 0.3"/>{drawer}</body>
  <body name="door" pos="-0.22 -0.19 0.06"><joint name="hinge" axis="0 0 -1" range="0 1.5"/>{door}
    <body name="knob" pos="0.4 0 0.12"><joint name="lock" axis="0 1 0" range="-1 1"/>{knob}</body>
  </body></body></worldbody></mujoco>
"""


def urdf():
    boxes = {
        link: "".join(
            f'<visual><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></visual>'
            for at, size in boards
        )
        for link, boards in BOARDS.items()
    }
    links = "".join(f'<link name="{link}">{inside}</link>' for link, inside in boxes.items())
    return f'<robot name="cabinet">{links}{JOINTS}</robot>'


def mjcf():
    def half(size):
        return " ".join(str(float(side) / 2) for side in size.split())

    boxes = {
        link: "".join(f'<geom type="box" pos="{at}" size="{half(size)}"/>' for at, size in boards)
        for link, boards in BOARDS.items()
    }
    return IN_MJCF.format(**boxes).replace("<mujoco>", '<mujoco><compiler angle="radian"/>')


def cabinet(folder, kind="urdf"):
    path = folder / f"cabinet.{'urdf' if kind == 'urdf' else 'xml'}"
    path.write_text(urdf() if kind == "urdf" else mjcf())
    (source,) = find_sources(path)
    opened = {"rail": OPEN, "hinge": AJAR, "lock": 0}
    return support_with_notes(read_shape(source, ReadOptions(up="z"), opened, 4.0))[0]


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_joints_stand_where_they_were_opened_and_move_what_is_theirs(tmp_path, kind):
    support = cabinet(tmp_path, kind)
    rail, hinge, lock = support.joints
    assert [each.name for each in support.joints] == ["rail", "hinge", "lock"]
    assert [each.kind for each in support.joints] == ["slide", "hinge", "hinge"]
    assert [each.parent for each in support.joints] == [-1, -1, 1]
    assert (rail.value, hinge.value) == (pytest.approx(OPEN), pytest.approx(np.radians(AJAR)))
    assert (rail.range, lock.range) == (pytest.approx((0, 0.3)), pytest.approx((-1, 1)))
    np.testing.assert_allclose(np.abs(rail.axis), (0, 1, 0), atol=1e-6)
    # The drawer has its boards, whatever their number among all, and nothing else has them.
    solids = [support.boxes[number].mesh.vertices for number in rail.boxes]
    solids += [support.parts[number].vertices for number in rail.parts]
    points = np.concatenate(solids)
    surface = np.concatenate([support.pieces[number].mesh.vertices for number in rail.pieces])
    np.testing.assert_allclose(points.min(0), surface.min(0), atol=0.003)
    np.testing.assert_allclose(points.max(0), surface.max(0), atol=0.003)
    owned = [number for joint in support.joints for number in joint.boxes]
    assert len(owned) == len(set(owned)) < len(support.boxes)


def test_limits_that_a_file_does_not_keep_to_are_widened_and_huge_ones_are_none(tmp_path):
    support = cabinet(tmp_path)
    rail, hinge, lock = support.joints
    odd = (replace(rail, range=(0.3, 0.4)), replace(hinge, range=(-1e5, 1e5)), lock)
    again = read_support(write_support(tmp_path / "odd", with_joints(support, odd)))
    assert [each.range for each in again.joints] == [pytest.approx((OPEN, 0.4)), None, lock.range]


def test_joints_are_kept_with_the_support(tmp_path):
    support = cabinet(tmp_path)
    again = read_support(write_support(tmp_path / "kept", support))
    assert support_hash(again) == support_hash(support)
    assert [each.name for each in again.joints] == ["rail", "hinge", "lock"]
    looped = replace(support, joints=tuple(replace(each, parent=0) for each in support.joints))
    with pytest.raises(PoolError, match="'rail' is not sound"):
        read_support(write_support(tmp_path / "looped", looped))


def test_drawers_and_doors_move_in_an_export_and_stand_until_they_are_pulled(tmp_path, scene):
    support = cabinet(tmp_path)
    drawer = next(surface for surface in support.surfaces if abs(surface.position[2] - 0.41) < 0.01)
    low = drawer.polygon.min(0)
    high = drawer.polygon.max(0)
    poses = scene.poses[:1].copy()
    poses[0, :2] = (low[0] + high[0]) / 2, low[1] + 0.15
    poses[0, 2] += drawer.position[2] - scene.support.top
    one = replace(
        scene,
        support=support,
        poses=poses,
        names=scene.names[:1],
        objects=scene.objects[:1],
        cameras=(),
    )
    out = export_scenes([one], tmp_path / "out", WITH_JOINTS)
    model = mujoco.MjModel.from_xml_path(str(out / "scenes" / "000000.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("scene").id)
    mujoco.mj_forward(model, data)
    joints = {model.joint(index).name.split(".")[-1]: index for index in range(3)}
    assert set(joints) == {"rail", "hinge", "lock"}
    rail = model.jnt_qposadr[joints["rail"]]
    assert data.qpos[rail] == pytest.approx(OPEN)
    np.testing.assert_allclose(data.body(one.names[0]).xpos, poses[0, :3], atol=1e-6)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 1000)
    np.testing.assert_allclose(data.qpos, start, atol=0.002)
    for _ in range(2000):
        data.qfrc_applied[model.jnt_dofadr[joints["rail"]]] = -60
        mujoco.mj_step(model, data)
    assert data.qpos[rail] == pytest.approx(0, abs=0.01)
    # What lies in it came along.
    moved = data.body(one.names[0]).xpos - poses[0, :3]
    assert abs(moved[1]) > OPEN / 2
    assert abs(moved[2]) < 0.02


def test_a_support_without_joints_is_refused(tmp_path, scene):
    with pytest.raises(ConfigError, match="`joints` with support"):
        export_scenes([scene], tmp_path / "out", WITH_JOINTS)
    assert not (tmp_path / "out").exists()


STATED = {
    '<joint name="rail" type="prismatic">': '<joint name="rail" type="prismatic">'
    '<dynamics damping="7" friction="0.4"/>',
    '<link name="drawer">': '<link name="drawer"><inertial><origin xyz="0 0 0.05"/><mass value="2.5"/>'
    '<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0.001"/></inertial>',
}


def test_what_a_file_states_of_its_joints_is_what_is_exported_and_the_rest_is_named(
    tmp_path, scene
):
    text = urdf()
    for plain, stated in STATED.items():
        text = text.replace(plain, stated)
    path = tmp_path / "cabinet.urdf"
    path.write_text(text)
    (source,) = find_sources(path)
    shape = read_shape(source, ReadOptions(up="z"), {"rail": OPEN, "hinge": 0, "lock": 0}, 4.0)
    support = read_support(write_support(tmp_path / "kept", support_with_notes(shape)[0]))
    (said,) = estimates_of(support.joints)
    assert "mass, damping, friction of 'hinge', 'lock'; armature of 'rail', 'hinge', 'lock'" in said
    one = replace(scene, support=support, cameras=())
    out = export_scenes([one], tmp_path / "out", WITH_JOINTS)
    model = mujoco.MjModel.from_xml_path(str(out / "scenes" / "000000.xml"))
    rail, hinge = (
        next(k for k in range(model.njnt) if model.joint(k).name.endswith(name))
        for name in ("rail", "hinge")
    )
    dof = model.jnt_dofadr[rail]
    body = model.jnt_bodyid[rail]
    assert model.body_mass[body] == pytest.approx(2.5)
    np.testing.assert_allclose(sorted(model.body_inertia[body]), [0.02, 0.0299, 0.0401], atol=1e-4)
    # The rail is level, so what its file says of friction is enough.
    assert model.dof_damping[dof] == pytest.approx(7)
    assert model.dof_frictionloss[dof] == pytest.approx(0.4)
    assert model.dof_damping[model.jnt_dofadr[hinge]] == pytest.approx(1)
    floor = min(piece.mesh.bounds[0, 2] for piece in support.pieces)
    assert model.body_ipos[body][2] == pytest.approx(0.45 + floor, abs=0.01)


def test_mjcf_states_masses_and_dynamics_and_a_lid_that_would_fall_is_held(tmp_path):
    text = mjcf().replace(
        'axis="0 -1 0" range', 'axis="0 0 -1" damping="3" frictionloss="0.5" range'
    )
    path = tmp_path / "cabinet.xml"
    path.write_text(text)
    (source,) = find_sources(path)
    shape = read_shape(source, ReadOptions(up="z"), {}, 4.0)
    rail = shape.joints[0]
    model = mujoco.MjModel.from_xml_path(str(path))
    assert rail.mass == pytest.approx(model.body("drawer").mass[0])
    assert (rail.damping, rail.friction, rail.armature) == (3, 0.5, None)
    half = shape.joints[0].transform(np.eye(3), 0.5, np.zeros(3), 0.125)
    assert half.mass == pytest.approx(rail.mass / 8)
    np.testing.assert_allclose(half.inertia, np.array(rail.inertia) / 32)
