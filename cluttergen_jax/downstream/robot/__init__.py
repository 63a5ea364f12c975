"""What a robot arm does with scenes: grasps, motion, episodes in MuJoCo, and what is kept of them."""

from typing import TYPE_CHECKING

from cluttergen_jax.lazy import offer

if TYPE_CHECKING:
    from cluttergen_jax.downstream.robot.cameras import above, wrist_camera
    from cluttergen_jax.downstream.robot.check import RobotCheck, usable_robot
    from cluttergen_jax.downstream.robot.description import RobotDescription, find_robot
    from cluttergen_jax.downstream.robot.film import check_films
    from cluttergen_jax.downstream.robot.grasping.grasp_dataset import GraspDataset
    from cluttergen_jax.downstream.robot.grasping.grasps import GraspFinder, Grasps, GraspSets
    from cluttergen_jax.downstream.robot.grasping.grips import FIRM, first_grasp, rank_grasps
    from cluttergen_jax.downstream.robot.grasping.suction import SuctionCup
    from cluttergen_jax.downstream.robot.model import base_pose
    from cluttergen_jax.downstream.robot.motion.collision import ROOM, ROOMS, Mode, PlanningWorld
    from cluttergen_jax.downstream.robot.motion.execute import Execution, Phase, Trace
    from cluttergen_jax.downstream.robot.motion.ik import ArmKinematics
    from cluttergen_jax.downstream.robot.motion.mover import Mover
    from cluttergen_jax.downstream.robot.motion.plan import PickPlan
    from cluttergen_jax.downstream.robot.outcome import (
        Ending,
        Endings,
        Failed,
        Outcome,
        run_to_end,
        success_of,
    )
    from cluttergen_jax.downstream.robot.protocols import GraspSource, PathPlanner
    from cluttergen_jax.downstream.robot.recorder import STARTS, DemonstrationRecorder, RecordAsked
    from cluttergen_jax.downstream.robot.sensing_arm import ArmSilhouette
    from cluttergen_jax.downstream.robot.trials import (
        EPISODES,
        RobotTrials,
        episode_seed,
        make_episodes,
        planner_hash,
        planner_recipe,
    )

__getattr__, __all__ = offer(
    __name__,
    {
        "cameras": ("above", "wrist_camera"),
        "check": ("RobotCheck", "usable_robot"),
        "description": ("RobotDescription", "find_robot"),
        "film": ("check_films",),
        "grasping.grasp_dataset": ("GraspDataset",),
        "grasping.grasps": ("GraspFinder", "GraspSets", "Grasps"),
        "grasping.grips": ("FIRM", "first_grasp", "rank_grasps"),
        "grasping.suction": ("SuctionCup",),
        "model": ("base_pose",),
        "motion.collision": ("Mode", "PlanningWorld", "ROOM", "ROOMS"),
        "motion.execute": ("Execution", "Phase", "Trace"),
        "motion.ik": ("ArmKinematics",),
        "motion.mover": ("Mover",),
        "motion.plan": ("PickPlan",),
        "outcome": (
            "Ending",
            "Endings",
            "Failed",
            "Outcome",
            "run_to_end",
            "success_of",
        ),
        "protocols": ("GraspSource", "PathPlanner"),
        "recorder": ("DemonstrationRecorder", "RecordAsked", "STARTS"),
        "sensing_arm": ("ArmSilhouette",),
        "trials": (
            "EPISODES",
            "RobotTrials",
            "episode_seed",
            "make_episodes",
            "planner_hash",
            "planner_recipe",
        ),
    },
)
