"""The native engine alone: purity, sleep, failures, threads and what it leaves behind."""

import dataclasses
import os
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.physics import native
from cluttergen_jax.physics.host import NumberedEngines, empty_settling
from cluttergen_jax.physics.native import NativePhysics
from cluttergen_jax.physics.simulations import Simulations
from cluttergen_jax.types import Verdict
from tests.helpers.worlds import TOP, box, layout_of, scene, tilted, trio

CONFIG = StabilityConfig()


@pytest.fixture(scope="module")
def layout():
    return layout_of(trio())


@pytest.fixture(scope="module")
def engine(layout):
    return NativePhysics(layout, CONFIG)


@pytest.fixture(scope="module")
def ten():
    return layout_of([box(f"box-{i}", (0.03, 0.04, 0.05)) for i in range(10)])


def settle(engine, *scenes, focus=0):
    poses, is_placed = (np.stack(arrays) for arrays in zip(*scenes, strict=True))
    focus = np.broadcast_to(focus, len(poses))
    return engine.settle_batch(poses, is_placed, focus, np.ones(len(poses), bool))


def stand(engine, *scenes):
    poses, is_placed = (np.stack(arrays) for arrays in zip(*scenes, strict=True))
    return engine.stand_batch(poses, is_placed, np.ones(len(poses), bool))


def fields(report, row):
    return {f.name: getattr(report, f.name)[row] for f in dataclasses.fields(report)}


def assert_same(first, second):
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name], err_msg=name)


def verdicts(report):
    return [Verdict(int(verdict)) for verdict in report.verdict]


def random_scenes(layout, num_scenes, seed):
    """Scenes of every kind: apart, stacked, overlapping, tilted, over the edge; and their focus objects."""
    rng = np.random.default_rng(seed)
    scenes = []
    focus = []
    for _ in range(num_scenes):
        chosen = rng.permutation(layout.num_objects)[: rng.integers(1, layout.num_objects + 1)]
        half = (0.05, 0.03, 0.1)
        placed = {
            int(k): (
                *rng.uniform(-0.1, 0.1, 2) * rng.choice([0.3, 1, 3.5]),
                TOP + half[k] + rng.uniform(0, 0.004),
            )
            for k in chosen
        }
        axis = rng.normal(size=3)
        turned = {int(chosen[0]): tilted(axis / np.linalg.norm(axis), rng.choice([0, 1, 8, 90]))}
        scenes.append(scene(layout, placed, turned))
        focus.append(int(chosen[0]))
    return scenes, focus


def test_five_hundred_settles_in_any_order_are_each_as_from_a_fresh_engine(layout, engine):
    scenes, focus = random_scenes(layout, 60, seed=0)
    fresh = []
    for one, index in zip(scenes, focus, strict=True):
        fresh.append(
            fields(settle(NativePhysics(layout, CONFIG, num_threads=1), one, focus=index), 0)
        )
    assert len({int(one["verdict"]) for one in fresh}) >= 4
    rng = np.random.default_rng(1)
    num_settles = 0
    while num_settles < 500:
        chosen = rng.integers(len(scenes), size=rng.choice([1, 2, 5, 40]))
        report = settle(
            engine, *(scenes[i] for i in chosen), focus=np.array([focus[i] for i in chosen])
        )
        for row, i in enumerate(chosen):
            assert_same(fields(report, row), fresh[i])
        if rng.uniform() < 0.2:
            stand(engine, scenes[chosen[0]])
        num_settles += len(chosen)


def test_stand_is_pure_too(layout, engine):
    scenes, _ = random_scenes(layout, 12, seed=2)
    together = stand(engine, *scenes)
    for row in np.random.default_rng(0).permutation(12):
        assert_same(fields(stand(engine, scenes[row]), 0), fields(together, row))
        assert_same(
            fields(stand(NativePhysics(layout, CONFIG), scenes[row]), 0), fields(together, row)
        )


def test_neither_threads_nor_cuts_change_a_bit(layout):
    scenes, focus = random_scenes(layout, 30, seed=3)
    reports = [
        settle(NativePhysics(layout, CONFIG, threads, size), *scenes, focus=np.array(focus))
        for threads, size in ((1, 128), (3, 128), (0, 7))
    ]
    for row in range(30):
        assert_same(fields(reports[0], row), fields(reports[1], row))
        assert_same(fields(reports[0], row), fields(reports[2], row))


def oracle(layout, poses, focus):
    """Steps until quiet, verdict and final pose by a plain loop over MuJoCo, everything awake."""
    model = layout.model
    data = mujoco.MjData(model)
    data.qpos[:] = layout.parked.ravel()
    data.qpos[7 * focus : 7 * focus + 7] = poses[focus]
    velocity = np.zeros(6)
    hold = 0
    num_steps = 0
    while hold < 20 and num_steps < 240:
        num_steps += 1
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        now = data.qvel[6 * focus : 6 * focus + 6].copy()
        now[3:] = data.xmat[layout.body_index[focus]].reshape(3, 3) @ now[3:]
        change = (now - velocity) * 240
        velocity = now
        quiet = np.linalg.norm(now[:3]) < 0.005 and np.linalg.norm(change[:3]) < 1
        quiet &= np.linalg.norm(now[3:]) < np.radians(0.5) and np.linalg.norm(
            change[3:]
        ) < np.radians(180)
        hold = hold + 1 if quiet else 0
    return num_steps, num_steps <= 60 and hold == 20, data.qpos[7 * focus : 7 * focus + 7]


@pytest.mark.parametrize("height", [0.0, 0.001, 0.005, 0.02, 0.05, 0.2])
def test_a_dropped_box_is_judged_as_by_a_plain_loop(layout, height):
    engine = NativePhysics(layout, StabilityConfig(stop_when_decided=False))
    one = scene(layout, {0: (0.1, 0.05, TOP + 0.05 + height)}, {0: tilted((0, 0, 1), 30)})
    report = settle(engine, one)
    num_steps, is_stable, pose = oracle(layout, one[0], 0)
    assert report.num_steps[0] == num_steps
    assert verdicts(report) == [Verdict.STABLE if is_stable else Verdict.UNSETTLED]
    np.testing.assert_allclose(report.poses[0, 0], pose, atol=1e-5)


def test_the_trajectory_is_what_happened(engine, layout):
    report = settle(engine, scene(layout, {0: (0.0, 0.0, TOP + 0.06)}, {0: tilted((1, 0, 0), 5)}))
    num_steps = int(report.num_steps[0])
    rows = report.trajectory[0].astype(np.float64)
    assert not rows[num_steps + 1 :].any()
    np.testing.assert_array_equal(rows[0, 7:], 0)
    # Semi-implicit Euler: the position moves by the new velocity.
    moved = np.diff(rows[: num_steps + 1, :3], axis=0)
    np.testing.assert_allclose(moved, rows[1 : num_steps + 1, 7:10] / 240, atol=1e-6)
    np.testing.assert_array_equal(report.trajectory[0, num_steps, :7], report.poses[0, 0])
    change = np.diff(rows[: num_steps + 1, 7:], axis=0) * 240
    motion = np.linalg.norm(rows[1 : num_steps + 1, 7:], axis=1) + np.linalg.norm(change, axis=1)
    np.testing.assert_allclose(report.motion_sum[0], motion.sum(), rtol=1e-4)
    np.testing.assert_allclose(report.speed_sum[0], np.abs(rows[:, 7:]).sum(), rtol=1e-4)


def test_an_inactive_scene_costs_no_step_and_returns_its_input(layout, engine, monkeypatch):
    steps = []
    run = Simulations.run

    def counted(self, ids, num_steps):
        steps.extend([len(ids)] * num_steps)
        return run(self, ids, num_steps)

    monkeypatch.setattr(Simulations, "run", counted)
    poses, is_placed = (np.stack([array] * 4) for array in scene(layout, {0: (0, 0, np.nan)}))
    report = engine.settle_batch(poses, is_placed, np.zeros(4, int), np.zeros(4, bool))
    standing = engine.stand_batch(poses, is_placed, np.zeros(4, bool))
    assert steps == []
    assert verdicts(report) == verdicts(standing) == [Verdict.NONE] * 4
    np.testing.assert_array_equal(report.poses, poses)
    poses[1] = scene(layout, {0: (0, 0, TOP + 0.051)})[0]
    report = engine.settle_batch(poses, is_placed, np.zeros(4, int), np.arange(4) == 1)
    assert verdicts(report) == [Verdict.NONE, Verdict.STABLE, Verdict.NONE, Verdict.NONE]
    assert set(steps) == {1}
    assert 0 <= len(steps) - report.num_steps[1] < 4


def test_steps_made_at_once_are_judged_one_by_one(ten, monkeypatch):
    """Verdicts, motions and poses do not depend on how many steps MuJoCo is asked for at a time."""
    rng = np.random.default_rng(3)
    num = 48
    num_objects = ten.num_objects
    poses = np.zeros((num, num_objects, 7))
    poses[..., :2] = rng.uniform(-0.25, 0.25, (num, num_objects, 2))
    poses[..., 2] = TOP + rng.uniform(0.02, 0.15, (num, num_objects))
    poses[..., 3:] = rng.normal(size=(num, num_objects, 4))
    poses[:8, 0, :3] = poses[:8, 1, :3]  # one inside another: some of it flies apart
    arguments = poses, rng.random((num, num_objects)) < 0.5, rng.integers(num_objects, size=num)
    arguments[1][np.arange(num), arguments[2]] = True
    config = StabilityConfig(stop_when_decided=False)
    reports = []
    for one_by_one in (False, True):
        engine = NativePhysics(ten, config)
        if one_by_one:
            monkeypatch.setattr(native._Attempt, "_steps_to_verdict", lambda *_: 1)
            monkeypatch.setattr(NativePhysics, "_steps_to_verdict", lambda *_: 1)
        reports.append(engine.settle_batch(*arguments, np.ones(num, bool)))
        reports.append(engine.stand_batch(*arguments[:2], np.ones(num, bool)))
    assert len(set(reports[0].verdict.tolist())) > 2
    assert len(set(reports[0].num_steps.tolist())) > 10
    for at_once, one_by_one in zip(reports[:2], reports[2:], strict=True):
        assert_same(vars(at_once), vars(one_by_one))


def test_who_may_sleep(layout, engine):
    sims = engine.simulations(1)
    asleep = sims._batch.bind("tree_asleep")
    poses, is_placed = scene(layout, {0: (0, 0, TOP + 0.04998), 1: (0.2, 0, TOP + 0.02997)})
    for awake, expected in (
        (is_placed, [False, False, True]),
        (is_placed & [True, False, False], [False, True, True]),
    ):
        sims.release(poses[None], is_placed[None], awake[None])
        for _ in range(300):
            sims.step(np.array([0]))
        np.testing.assert_array_equal(asleep[0] >= 0, expected)
        np.testing.assert_array_equal(sims.poses(np.array([0]))[0, 2], layout.parked[2])


def test_the_focus_object_never_sleeps_however_long_it_rests(layout):
    engine = NativePhysics(layout, StabilityConfig(quiet_steps=200))
    report = settle(engine, scene(layout, {0: (0, 0, TOP + 0.04998)}))
    assert report.num_steps[0] >= 200
    # A sleeping object's velocity is exactly zero, a resting one's is not.
    assert (np.abs(report.trajectory[0, 1:201, 7:]).max(axis=1) > 0).all()


def test_a_neighbour_asleep_wakes_when_it_is_hit(layout):
    engine = NativePhysics(layout, StabilityConfig(stop_when_decided=False))
    # The tall box leans over slowly enough for its neighbour to be asleep when it strikes.
    report = settle(
        engine,
        scene(
            layout,
            {2: (0.0, 0.0, TOP + 0.1003), 0: (0.12, 0, TOP + 0.05)},
            {2: tilted((0, 1, 0), 7)},
        ),
        focus=2,
    )
    assert report.shift[0, 0] > 1e-4
    assert report.turn[0, 2] == 0  # the current object is no neighbour


def test_a_slow_topple_is_seen_awake_to_the_end(layout, engine):
    one = scene(
        layout,
        {2: (0, 0, TOP + 0.1 * np.cos(0.1) + 0.01 * np.sin(0.1))},
        {2: tilted((0, 1, 0), 5.73)},
    )
    data = mujoco.MjData(layout.model)
    data.qpos[:] = layout.parked.ravel()
    data.qpos[14:21] = one[0][2]
    farthest = 0.0
    for _ in range(480):
        mujoco.mj_step(layout.model, data)
        farthest = max(farthest, np.linalg.norm(data.qpos[14:17] - one[0][2, :3]))
    standing = stand(engine, one)
    assert verdicts(standing) == [Verdict.CREPT]
    np.testing.assert_allclose(standing.shift[0], [0, 0, farthest], rtol=1e-3)


@pytest.mark.parametrize("name", ["max_added_penetration", "max_penetration"])
def test_the_depth_that_a_pair_may_have_is_the_configs(layout, name):
    strict = NativePhysics(layout, StabilityConfig(**{name: 1e-6}))
    one = scene(layout, {0: (0, 0, TOP + 0.0501)})
    assert verdicts(settle(strict, one)) == [Verdict.PENETRATING]
    relaxed = settle(NativePhysics(layout, CONFIG), one)
    assert verdicts(relaxed) == [Verdict.STABLE]
    assert 1e-6 < relaxed.penetration[0] < 1e-4


def test_a_diverged_scene_leaves_the_other_sixty_three_alone(layout, engine):
    scenes, focus = random_scenes(layout, 64, seed=4)
    before = settle(engine, *scenes, focus=np.array(focus))
    standing_before = stand(engine, *scenes)
    for bad in (np.nan, np.inf, 1e30):
        broken = [(poses.copy(), is_placed) for poses, is_placed in scenes]
        broken[17][0][focus[17], 1] = bad
        after = settle(engine, *broken, focus=np.array(focus))
        standing_after = stand(engine, *broken)
        assert verdicts(after)[17] == verdicts(standing_after)[17] == Verdict.NON_FINITE
        np.testing.assert_array_equal(after.poses[17], broken[17][0])
        assert np.isfinite(after.motion_sum).all()
        assert np.isfinite(after.trajectory).all()
        assert np.isfinite(standing_after.shift).all()
        for row in set(range(64)) - {17}:
            assert_same(fields(after, row), fields(before, row))
            assert_same(fields(standing_after, row), fields(standing_before, row))


def test_a_scene_that_diverges_on_its_way_is_not_finite():
    wild = layout_of(
        [box("light", (0.03, 0.04, 0.05), 1e-6), box("heavy", (0.3, 0.3, 0.05), 1e6)],
        ContactConfig(solref=(1e-5, 1e-6)),
    )
    proposal = scene(wild, {0: (0, 0, TOP + 0.01), 1: (0, 0, TOP + 0.01)})
    report = settle(NativePhysics(wild, CONFIG), proposal)
    assert verdicts(report) == [Verdict.NON_FINITE]
    assert report.num_steps[0] > 0
    assert not report.motion_sum.any()
    # It costs no step more where every attempt may take 240.
    patient = NativePhysics(wild, StabilityConfig(stop_when_decided=False))
    assert settle(patient, proposal).num_steps[0] == report.num_steps[0] < CONFIG.decision_step


@pytest.mark.parametrize("memory", [20_000, 50_000])
def test_a_full_arena_is_overflow_of_that_scene_alone(ten, memory):
    def shrink(spec):
        spec.memory = memory

    small = layout_of([box(f"box-{i}", (0.03, 0.04, 0.05)) for i in range(10)], edit=shrink)
    engine = NativePhysics(small, CONFIG)
    roomy = NativePhysics(ten, CONFIG)
    one = scene(ten, {0: (0, 0, TOP + 0.051)})
    crowd = scene(ten, dict.fromkeys(range(10), (0, 0, TOP + 0.06)))
    for _ in range(2):  # The warnings of the first call do not haunt the second.
        report = settle(engine, one, crowd, one)
        standing = stand(engine, one, crowd, one)
        assert verdicts(report) == [Verdict.STABLE, Verdict.OVERFLOW, Verdict.STABLE]
        assert verdicts(standing) == [Verdict.STABLE, Verdict.OVERFLOW, Verdict.STABLE]
        assert_same(fields(report, 0), fields(settle(roomy, one), 0))
        again = settle(engine, one, one, one)
        assert verdicts(again) == [Verdict.STABLE] * 3


def test_calls_from_many_threads_are_each_right(layout, engine):
    scenes, focus = random_scenes(layout, 40, seed=5)
    expected = settle(engine, *scenes, focus=np.array(focus))

    def work(seed):
        rng = np.random.default_rng(seed)
        number = 0
        for _ in range(8):
            chosen = rng.integers(40, size=rng.integers(1, 6))
            report = settle(
                engine, *(scenes[i] for i in chosen), focus=np.array([focus[i] for i in chosen])
            )
            for row, i in enumerate(chosen):
                assert_same(fields(report, row), fields(expected, i))
                number += 1
        return number

    # What is raised in a thread is raised here.
    with ThreadPoolExecutor(6) as threads:
        assert min(threads.map(work, range(6))) >= 8


def run_python(code, folder, timeout):
    """Runs `code` in a fresh interpreter whose working folder is `folder`."""
    here = Path(__file__).resolve().parent
    path = os.pathsep.join([str(here.parents[1]), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def test_many_callbacks_with_large_arguments_do_not_deadlock(tmp_path):
    # Callbacks run on XLA's own threads, and converting large arguments there may wait for such a thread
    # (jax issue 24255). With `jax.pure_callback` this very program hung in its first second on two cores.
    code = """
        import threading
        import jax, jax.numpy as jnp, numpy as np
        from tests.helpers.worlds import *
        from cluttergen_jax.physics.native import NativePhysics

        num_objects, num_scenes = 40, 512
        layout = layout_of([box(f"box-{i}", (0.03, 0.04, 0.05)) for i in range(num_objects)])
        engine = NativePhysics(layout, StabilityConfig())
        poses, is_placed = scene(layout, {0: (0, 0, 0.751)})
        poses, is_placed = np.stack([poses] * num_scenes), np.stack([is_placed] * num_scenes)
        is_active = np.arange(num_scenes) < 1
        settle, stand = jax.vmap(engine.settle), jax.vmap(engine.stand)

        @jax.jit
        def work(poses, is_placed, is_active):
            def step(poses, _):
                none = is_active & False
                checks = [stand(poses[::-1] + i, is_placed[::-1], none) for i in range(4)]
                moved = sum(check.shift.sum() for check in checks)
                return poses + 0 * moved, checks[0].verdict
            poses, _ = jax.lax.scan(step, poses, None, length=100)
            return settle(poses, is_placed, jnp.zeros(num_scenes, int), is_active).verdict

        def run():
            for _ in range(2):
                verdict = np.asarray(work(poses, is_placed, is_active))
                assert (verdict == np.where(is_active, 0, -1)).all()
            print("done")

        threads = [threading.Thread(target=run) for _ in range(2)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
    """
    done = run_python(code, tmp_path, timeout=120)
    assert done.stdout.split() == ["done", "done"], done.stderr


def test_numbered_engines_are_each_asked_for_their_own_scenes():
    made = []

    class Engine:
        config = StabilityConfig()

        def __init__(self, number):
            self.number = number
            made.append(number)

        def settle_batch(self, poses, is_placed, focus, is_active):
            found = empty_settling(np, (len(poses),), 1, self.config)
            return found.replace(num_steps=found.num_steps + self.number, poses=poses + self.number)

        def free(self):
            made.append(f"free {self.number}")

    engines = NumberedEngines(1, StabilityConfig(), Engine)

    def settle(number, poses):
        return engines.with_number(number).settle(poses, jnp.ones(1, bool), 0, True)

    poses = jnp.zeros((5, 1, 7))
    numbers = jnp.array([4, 2, 4, 2, 2])
    found = jax.jit(jax.vmap(settle))(numbers, poses)
    np.testing.assert_array_equal(found.num_steps, numbers)
    np.testing.assert_array_equal(found.poses[:, 0, 0], numbers)
    alone = jax.jit(jax.vmap(settle, in_axes=(None, 0)))(jnp.int32(4), poses)
    np.testing.assert_array_equal(alone.num_steps, np.full(5, 4))
    assert made == [2, "free 2", 4]
    at_once = engines.with_number(4).settle_batch(
        np.zeros((2, 1, 7)), np.ones((2, 1)), np.zeros(2), np.ones(2)
    )
    np.testing.assert_array_equal(at_once.num_steps, [4, 4])
