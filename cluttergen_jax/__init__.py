"""Cluttered, physically stable, diverse tabletop scenes on JAX and MuJoCo.

    sample = cluttergen_jax.make_sampler(pool="dining", num_objects=10)    # sample(key) -> SceneBatch
    bank = cluttergen_jax.load_bank("out")                                 # bank.reset(key) -> BankArrays
    env = cluttergen_jax.make_env(pool="dining", num_objects=5)            # a Brax environment, to train in
    envs = cluttergen_jax.envs.make_vector_env(64, pool="dining")          # a VectorEnv of Gymnasium
    env = cluttergen_jax.make_mjx_env("out", robot="panda", task="grasp")  # a robot in its scenes, on MJX
    bank = cluttergen_jax.load_bank("owner/name")                          # pulled from a hub

Every command has a function with the same defaults and the same names of options:

    import_pool, import_support    meshes, URDF, SDF, MJCF -> a pool, a support
    generate, verify, stats        scenes -> a bank on disk; which are stable; what it holds
    certify, judge, repair         measures of stability; anybody's scenes by one strict rule; broken layouts
    export, render, view           scenes -> other programs, pictures, a viewer
    cut                            some scenes of a bank -> a bank
    make_dataset                   what cameras see of thousands of scenes, in files for trainers
    train, evaluate                a pool -> a policy; methods side by side
    place_by_hand                  a person's scenes -> a bank
    rearrange                      objects brought into new layouts by a robot arm
    propose_places                 depth images of your own -> where an object will stand

More is in modules, which are loaded when they are first used:

    layout      ask, check, read, schema of files that say what shall stand where
    robot       grasps, place, dataset; make_env; robots of your own
    placer      data, train, eval of stable placement from what one camera sees
    perception  known objects in images
    pools       the pools and supports that there are; resting poses of objects
    envs        environments for Gymnasium, Stable-Baselines3, Brax
    hub         push_bank, pull_bank, pull_policies
    training    pretrain, train_suite
    typing      types for annotations: SceneBatch, BankArrays, Sampler ...

Five ways to read a bank:

    read_bank(path)     a `Bank`: the open folder; rows, failures and assets are read when asked for
    read_scenes(bank)   a `Scene` after another of those that stand, with meshes: to draw, export, change
    load_bank(path)     `BankArrays`: all that stand as JAX arrays in one MuJoCo model: resets for training
    stream_bank(path)   the same batch by batch, for banks that do not fit into memory
    stats(path)         `BankStats`: how many stand, why others failed; printed, a table

`Rectangle` tells `make_sampler` of a region or a keep-out box; `make_region` and `KeepOut` are for those of
`sample(key, region=..., keep_out=...)`, which may be traced. CONTRIBUTING.md says what the packages are.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from cluttergen_jax.api import display as _drawing
from cluttergen_jax.api.export import cut, export
from cluttergen_jax.api.generate import generate, place_by_hand, repair
from cluttergen_jax.api.import_ import import_pool, import_support
from cluttergen_jax.api.render import make_dataset, render, view
from cluttergen_jax.api.train import train
from cluttergen_jax.display import draw_with
from cluttergen_jax.downstream.words import ENV_IDS
from cluttergen_jax.graspable import answer_with
from cluttergen_jax.gymnasium_ids import register_ids
from cluttergen_jax.judging.api import certify, judge, verify
from cluttergen_jax.lazy import name_space
from cluttergen_jax.robot_environments import answer_with as write_environments_with
from cluttergen_jax.spec import SceneSpec

if TYPE_CHECKING:
    from cluttergen_jax import (
        envs,
        hub,
        layout,
        perception,
        placer,
        pools,
        robot,
        training,
        typing,
    )
    from cluttergen_jax.assets.pool import find_pool as load_pool
    from cluttergen_jax.assets.support import Rectangle
    from cluttergen_jax.assets.support_file import find_support as load_support
    from cluttergen_jax.downstream.environments.api import make_mjx_env
    from cluttergen_jax.downstream.placer.own_depth import propose_places
    from cluttergen_jax.downstream.rearrange.api import rearrange
    from cluttergen_jax.evaluation.api import evaluate
    from cluttergen_jax.generation import load_bank, make_sampler, stream_bank
    from cluttergen_jax.generation.environments import make_env
    from cluttergen_jax.placement.region import KeepOut, make_region
    from cluttergen_jax.scene import Scene
    from cluttergen_jax.scene.bank import Bank, read_bank
    from cluttergen_jax.scene.bank.scene import read_scenes
    from cluttergen_jax.scene.bank.stats import stats_of as stats
    from cluttergen_jax.scene.export import Format, register_format

__all__ = [
    "Bank",
    "Format",
    "KeepOut",
    "Rectangle",
    "Scene",
    "SceneSpec",
    "certify",
    "cut",
    "envs",
    "evaluate",
    "export",
    "generate",
    "hub",
    "import_pool",
    "import_support",
    "judge",
    "layout",
    "load_bank",
    "load_pool",
    "load_support",
    "make_dataset",
    "make_env",
    "make_mjx_env",
    "make_region",
    "make_sampler",
    "perception",
    "place_by_hand",
    "placer",
    "pools",
    "propose_places",
    "read_bank",
    "read_scenes",
    "rearrange",
    "register_format",
    "render",
    "repair",
    "robot",
    "stats",
    "stream_bank",
    "train",
    "training",
    "typing",
    "verify",
    "view",
]

# Scenes, banks and pools lie below what draws them, and below what knows hands.
draw_with(lambda: _drawing)
answer_with(
    lambda: import_module("cluttergen_jax.downstream.robot.grasping.holdable").graspable_names
)
write_environments_with(
    lambda: import_module("cluttergen_jax.downstream.environments.exporting").write_environment
)
# `gymnasium.make("cluttergen/Place-v1")`, whichever of the two is imported first.
register_ids(ENV_IDS)

_FORMER = {
    "BankArrays": "generation.bank:BankArrays",
    "RandomizationConfig": "downstream.environments.randomization:RandomizationConfig",
    "Replay": "placement.replay:Replay",
    "RobotDescription": "downstream.robot.description:RobotDescription",
    "RobotWorld": "downstream.environments.world:RobotWorld",
    "Sampler": "generation.sampler:Sampler",
    "SceneBatch": "placement.scenes:SceneBatch",
    "SceneOptions": "spec:SceneOptions",
    "ask_layout": "api.layout:ask_layout",
    "check_layout": "api.layout:check_layout",
    "grasp_dataset": "downstream.robot.api:grasp_dataset",
    "layout_schema": "generation.layout_check:layout_schema",
    "list_layouts": "generation.layouts:list_layouts",
    "list_pools": "assets.pool:list_pools",
    "list_robots": "downstream.robot.description:list_robots",
    "list_supports": "assets.support_file:list_supports",
    "make_gym_env": "generation.environments:make_gym_env",
    "make_robot_env": "downstream.environments.api:make_robot_env",
    "make_sb3_env": "generation.environments:make_sb3_env",
    "make_vector_env": "generation.environments:make_vector_env",
    "placer_data": "downstream.placer.api:placer_data",
    "placer_eval": "downstream.placer.api:placer_eval",
    "placer_train": "downstream.placer.api:placer_train",
    "pool_poses": "importing.poses:pool_poses",
    "pretrain": "api.train:pretrain",
    "pull_bank": "api.export:pull_bank",
    "pull_policies": "api.export:pull_policies",
    "push_bank": "api.export:push_bank",
    "read_layout": "generation.layouts:read_layout",
    "read_robot": "downstream.robot.description:read_robot",
    "remove_pool": "assets.pool:remove_pool",
    "robot_grasps": "downstream.robot.api:robot_grasps",
    "robot_place": "downstream.environments.api:robot_place",
    "scripted_actions": "downstream.environments.api:scripted_actions",
    "set_pose": "importing.poses:set_pose",
    "stats_of": "scene.bank.stats:stats_of",
    "stats_text": "scene.bank.stats:stats_text",
    "train_brax": "generation.environments:train_brax",
    "train_suite": "api.train:train_suite",
    "with_robot": "downstream.environments.world:with_robot",
}
"""Names that are in modules now, and go on working here."""

__getattr__, __dir__ = name_space(
    __name__,
    {
        "Bank": "scene.bank:Bank",
        "Format": "scene.export:Format",
        "KeepOut": "placement.region:KeepOut",
        "Rectangle": "assets.support:Rectangle",
        "Scene": "scene:Scene",
        "SceneSpec": "spec:SceneSpec",
        "certify": "judging.api:certify",
        "cut": "api.export:cut",
        "envs": "envs",
        "evaluate": "evaluation.api:evaluate",
        "export": "api.export:export",
        "generate": "api.generate:generate",
        "hub": "hub",
        "import_pool": "api.import_:import_pool",
        "import_support": "api.import_:import_support",
        "judge": "judging.api:judge",
        "layout": "layout",
        "load_bank": "generation:load_bank",
        "load_pool": "assets.pool:find_pool",
        "load_support": "assets.support_file:find_support",
        "make_dataset": "api.render:make_dataset",
        "make_env": "generation.environments:make_env",
        "make_mjx_env": "downstream.environments.api:make_mjx_env",
        "make_region": "placement.region:make_region",
        "make_sampler": "generation:make_sampler",
        "perception": "perception",
        "place_by_hand": "api.generate:place_by_hand",
        "placer": "placer",
        "pools": "pools",
        "propose_places": "downstream.placer.own_depth:propose_places",
        "read_bank": "scene.bank:read_bank",
        "read_scenes": "scene.bank.scene:read_scenes",
        "rearrange": "downstream.environments.api:rearrange",
        "register_format": "scene.export:register_format",
        "render": "api.render:render",
        "repair": "api.generate:repair",
        "robot": "robot",
        "stats": "scene.bank.stats:stats_of",
        "stream_bank": "generation:stream_bank",
        "train": "api.train:train",
        "training": "training",
        "typing": "typing",
        "verify": "judging.api:verify",
        "view": "api.render:view",
    },
    _FORMER,
)
