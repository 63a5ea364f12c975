"""Cluttered, physically stable, diverse tabletop scenes on JAX and MuJoCo.

    sample = cluttergen_jax.make_sampler(pool="dining", num_objects=10)    # sample(key) -> SceneBatch
    bank = cluttergen_jax.load_bank("out")                                 # bank.reset(key) -> BankArrays
    env = cluttergen_jax.make_env(pool="dining", num_objects=5)            # a Brax environment, to train in
    envs = cluttergen_jax.make_vector_env(64, pool="dining")               # a VectorEnv of Gymnasium
    bank = cluttergen_jax.load_bank("owner/name")                          # pulled from a hub

Every command has a function with the same defaults:

    import_pool, import_support    meshes, URDF, SDF, MJCF -> a pool, a support
    pool_poses, set_pose           the resting poses of an object of a pool; selects another one
    read_layout, check_layout      a file of objects and relations -> a request; all that is wrong with it
    layout_schema, ask_layout      its JSON schema; a sentence and a language model -> such a file
    generate, verify, stats_of     scenes -> a bank on disk; which are stable; what it holds
    judge, repair                  anybody's scenes by one strict rule; broken layouts -> stable ones
    train, train_suite, pretrain   a pool -> a policy; those of a suite; an encoder
    export, render, view           scenes -> other programs, pictures, a viewer
    make_dataset                   what cameras see of thousands of scenes, in files for trainers
    placer_data, placer_eval       pairs for stable placement; success rates of placers
    placer_train                   pairs -> a placer for what one camera sees
    place_by_hand                  a person's scenes -> a bank
    robot_grasps, robot_place      grasps of a pool's objects; objects moved by a simulated arm
    grasp_dataset                  labelled grasps in a bank's clutter
    read_robot                     a robot of your own, from a YAML file beside its models
    with_robot, make_robot_env     a bank and a robot in one model; Gymnasium's environment of it
    rearrange                      objects brought into new layouts by that arm
    push_bank, pull_bank           a bank to and from a hub
    pull_policies                  weights of ablations, which do not come with the package

`Rectangle` tells `make_sampler` of a region or a keep-out box; `make_region` and `KeepOut` are for those of
`sample(key, region=..., keep_out=...)`, which may be traced. CONTRIBUTING.md says what the packages are.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cluttergen_jax.api import display as _drawing
from cluttergen_jax.api.export import export, pull_bank, pull_policies, push_bank
from cluttergen_jax.api.generate import generate, place_by_hand, repair
from cluttergen_jax.api.import_ import import_pool, import_support
from cluttergen_jax.api.layout import ask_layout, check_layout
from cluttergen_jax.api.render import make_dataset, render, view
from cluttergen_jax.api.train import pretrain, train, train_suite
from cluttergen_jax.display import draw_with
from cluttergen_jax.judging.api import certify, judge, verify
from cluttergen_jax.spec import SceneOptions, SceneSpec

if TYPE_CHECKING:
    from cluttergen_jax.assets.pool import find_pool as load_pool
    from cluttergen_jax.assets.pool import list_pools, remove_pool
    from cluttergen_jax.assets.support import Rectangle
    from cluttergen_jax.assets.support_file import find_support as load_support
    from cluttergen_jax.assets.support_file import list_supports
    from cluttergen_jax.downstream.environments.api import make_robot_env, scripted_actions
    from cluttergen_jax.downstream.environments.randomization import RandomizationConfig
    from cluttergen_jax.downstream.environments.world import RobotWorld, with_robot
    from cluttergen_jax.downstream.placer.api import placer_data, placer_eval, placer_train
    from cluttergen_jax.downstream.rearrange.api import rearrange
    from cluttergen_jax.downstream.robot.api import grasp_dataset, robot_grasps, robot_place
    from cluttergen_jax.downstream.robot.description import (
        RobotDescription,
        list_robots,
        read_robot,
    )
    from cluttergen_jax.evaluation.api import evaluate
    from cluttergen_jax.generation import BankArrays, Sampler, load_bank, make_sampler, stream_bank
    from cluttergen_jax.generation.environments import (
        make_env,
        make_gym_env,
        make_sb3_env,
        make_vector_env,
        train_brax,
    )
    from cluttergen_jax.generation.layout_check import layout_schema
    from cluttergen_jax.generation.layouts import list_layouts, read_layout
    from cluttergen_jax.importing.poses import pool_poses, set_pose
    from cluttergen_jax.placement.region import KeepOut, make_region
    from cluttergen_jax.placement.replay import Replay
    from cluttergen_jax.placement.scenes import SceneBatch
    from cluttergen_jax.scene import Scene
    from cluttergen_jax.scene.bank import Bank, read_bank
    from cluttergen_jax.scene.bank.scene import read_scenes
    from cluttergen_jax.scene.bank.stats import stats_of, stats_text
    from cluttergen_jax.scene.export import Format, register_format

__all__ = [
    "Bank",
    "BankArrays",
    "Format",
    "KeepOut",
    "RandomizationConfig",
    "Rectangle",
    "Replay",
    "RobotDescription",
    "RobotWorld",
    "Sampler",
    "Scene",
    "SceneBatch",
    "SceneOptions",
    "SceneSpec",
    "ask_layout",
    "certify",
    "check_layout",
    "evaluate",
    "export",
    "generate",
    "grasp_dataset",
    "import_pool",
    "import_support",
    "judge",
    "layout_schema",
    "list_layouts",
    "list_pools",
    "list_robots",
    "list_supports",
    "load_bank",
    "load_pool",
    "load_support",
    "make_dataset",
    "make_env",
    "make_gym_env",
    "make_region",
    "make_robot_env",
    "make_sampler",
    "make_sb3_env",
    "make_vector_env",
    "place_by_hand",
    "placer_data",
    "placer_eval",
    "placer_train",
    "pool_poses",
    "pretrain",
    "pull_bank",
    "pull_policies",
    "push_bank",
    "read_bank",
    "read_layout",
    "read_robot",
    "read_scenes",
    "rearrange",
    "register_format",
    "remove_pool",
    "render",
    "repair",
    "robot_grasps",
    "robot_place",
    "scripted_actions",
    "set_pose",
    "stats_of",
    "stats_text",
    "stream_bank",
    "train",
    "train_brax",
    "train_suite",
    "verify",
    "view",
    "with_robot",
]

# Scenes, banks and pools lie below what draws them.
draw_with(lambda: _drawing)

# What is in no module of this list is in `generation`.
_MODULES = {
    "evaluation.api": ("evaluate",),
    "downstream.environments.api": ("make_robot_env", "scripted_actions"),
    "downstream.environments.randomization": ("RandomizationConfig",),
    "downstream.environments.world": ("RobotWorld", "with_robot"),
    "downstream.placer.api": ("placer_data", "placer_eval", "placer_train"),
    "downstream.rearrange.api": ("rearrange",),
    "downstream.robot.api": ("grasp_dataset", "robot_grasps", "robot_place"),
    "downstream.robot.description": ("RobotDescription", "list_robots", "read_robot"),
    "assets.pool": ("list_pools", "remove_pool"),
    "assets.support": ("Rectangle",),
    "assets.support_file": ("list_supports",),
    "importing.poses": ("pool_poses", "set_pose"),
    "scene": ("Scene",),
    "scene.export": ("Format", "register_format"),
    "scene.bank": ("Bank", "read_bank"),
    "scene.bank.scene": ("read_scenes",),
    "scene.bank.stats": ("stats_of", "stats_text"),
    "placement.region": ("KeepOut", "make_region"),
    "placement.replay": ("Replay",),
    "placement.scenes": ("SceneBatch",),
    "generation.layout_check": ("layout_schema",),
    "generation.layouts": ("list_layouts", "read_layout"),
    "generation.environments": (
        "make_env",
        "make_gym_env",
        "make_sb3_env",
        "make_vector_env",
        "train_brax",
    ),
}
_ELSEWHERE = {name: module for module, names in _MODULES.items() for name in names}
_RENAMED = {
    "load_pool": ("assets.pool", "find_pool"),
    "load_support": ("assets.support_file", "find_support"),
}


def __getattr__(name: str) -> Any:
    """The other names of `__all__`, imported when first asked for: JAX and MuJoCo take a second to load."""
    if name in __all__:
        module, there = _RENAMED.get(name, (_ELSEWHERE.get(name, "generation"), name))
        return getattr(import_module(f"cluttergen_jax.{module}"), there)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
