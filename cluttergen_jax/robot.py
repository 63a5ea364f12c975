"""A robot arm in scenes, as `cluttergen robot`: grasps, episodes, datasets of grasps, environments."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import name_space

if TYPE_CHECKING:
    from cluttergen_jax.downstream.environments.api import (
        evaluate_policy,
        scripted_actions,
        write_rerun,
    )
    from cluttergen_jax.downstream.environments.api import make_robot_env as make_env
    from cluttergen_jax.downstream.environments.api import robot_record as record
    from cluttergen_jax.downstream.environments.evaluation import PolicyEvaluation
    from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
    from cluttergen_jax.downstream.environments.recordings import Recording, read_recording
    from cluttergen_jax.downstream.environments.world import RobotWorld, with_robot
    from cluttergen_jax.downstream.robot.api import clear_clutter
    from cluttergen_jax.downstream.robot.api import grasp_dataset as dataset
    from cluttergen_jax.downstream.robot.api import robot_check as check
    from cluttergen_jax.downstream.robot.api import robot_grasps as grasps

    # The same function but for what `record` is handed on as.
    from cluttergen_jax.downstream.robot.api import robot_place as place
    from cluttergen_jax.downstream.robot.description import (
        RobotDescription,
        list_robots,
        read_robot,
    )
    from cluttergen_jax.downstream.robot.grasping.pads import set_pads
    from cluttergen_jax.downstream.robot.grasping.suction import SuctionCup

__all__ = [
    "PolicyEvaluation",
    "RandomizationConfig",
    "Recording",
    "RobotDescription",
    "RobotWorld",
    "SuctionCup",
    "check",
    "clear_clutter",
    "dataset",
    "evaluate_policy",
    "grasps",
    "list_robots",
    "make_env",
    "place",
    "read_recording",
    "read_robot",
    "record",
    "scripted_actions",
    "set_pads",
    "with_robot",
    "write_rerun",
]

__getattr__, __dir__ = name_space(
    __name__,
    {
        "PolicyEvaluation": "downstream.environments.evaluation:PolicyEvaluation",
        "RandomizationConfig": "downstream.environments.randomization:RandomizationConfig",
        "Recording": "downstream.environments.recordings:Recording",
        "RobotDescription": "downstream.robot.description:RobotDescription",
        "RobotWorld": "downstream.environments.world:RobotWorld",
        "check": "downstream.robot.api:robot_check",
        "clear_clutter": "downstream.robot.api:clear_clutter",
        "SuctionCup": "downstream.robot.grasping.suction:SuctionCup",
        "dataset": "downstream.robot.api:grasp_dataset",
        "evaluate_policy": "downstream.environments.api:evaluate_policy",
        "grasps": "downstream.robot.api:robot_grasps",
        "list_robots": "downstream.robot.description:list_robots",
        "make_env": "downstream.environments.api:make_robot_env",
        "place": "downstream.environments.api:robot_place",
        "read_recording": "downstream.environments.recordings:read_recording",
        "read_robot": "downstream.robot.description:read_robot",
        "record": "downstream.environments.api:robot_record",
        "scripted_actions": "downstream.environments.api:scripted_actions",
        "set_pads": "downstream.robot.grasping.pads:set_pads",
        "with_robot": "downstream.environments.world:with_robot",
        "write_rerun": "downstream.environments.api:write_rerun",
    },
)
