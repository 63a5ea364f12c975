"""The rule that judges stability, on NumPy and JAX arrays, against hand arithmetic and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import cross, norm, rotate, turn_between
from cluttergen_jax.physics import stability
from cluttergen_jax.physics.host import below_top, mask_scenes
from cluttergen_jax.types import Verdict

CONFIG = StabilityConfig()
STILL = np.zeros(6)
FAST = np.array([1.0, 0, 0, 0, 0, 0])


def random_quaternions(rng, *shape):
    quaternion = rng.normal(size=(*shape, 4))
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def as_scipy(quaternion):
    return Rotation.from_quat(np.asarray(quaternion)[..., [1, 2, 3, 0]])


def follow(velocities, config=CONFIG, xp=np, shift=None):
    """The track after a sequence of velocities, f[T, 6], stopping where it ends."""
    track = stability.new_track(xp, (), 2, xp.float32)
    nothing = xp.zeros(2)
    for step, velocity in enumerate(velocities):
        moved = nothing if shift is None else xp.asarray(shift[step])
        motion = stability.step_motion(xp, xp.asarray(velocity), track.velocity, config)
        track = stability.advance(xp, track, motion, moved, nothing, config)
        if bool(track.is_over):
            break
    return track


def judge(track, **changes):
    """The verdict over a current object (0) and a neighbour (1), nothing else having gone wrong."""
    facts = {
        "is_focus": np.array([True, False]),
        "is_neighbour": np.array([False, True]),
        "is_below": np.zeros(2, bool),
        "penetrates": np.array(False),
        "overflowed": np.array(False),
        "is_finite": np.array(True),
        "config": CONFIG,
    } | changes
    verdict, is_quiet = stability.verdict_of_attempt(np, track, **facts)
    return Verdict(int(verdict)), bool(is_quiet)


def test_turn_between_is_scipys_angle_at_every_size():
    rng = np.random.default_rng(0)
    first = random_quaternions(rng, 500)
    angle = np.concatenate([np.geomspace(1e-9, 1, 250), rng.uniform(0, np.pi, 250)])
    axis = rng.normal(size=(500, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turned = (as_scipy(first) * Rotation.from_rotvec(axis * angle[:, None])).as_quat()[
        :, [3, 0, 1, 2]
    ]
    np.testing.assert_allclose(turn_between(np, turned, first), angle, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(turn_between(np, -turned, first), angle, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(turn_between(np, first, turned), angle, rtol=1e-6, atol=1e-15)


def test_rotate_and_cross_agree_with_scipy_and_numpy():
    rng = np.random.default_rng(1)
    quaternion = random_quaternions(rng, 100)
    vector = rng.normal(size=(100, 3))
    np.testing.assert_allclose(
        rotate(np, quaternion, vector), as_scipy(quaternion).apply(vector), atol=1e-12
    )
    np.testing.assert_allclose(
        cross(np, vector, vector[::-1]), np.cross(vector, vector[::-1]), atol=1e-12
    )
    np.testing.assert_allclose(norm(np, vector), np.linalg.norm(vector, axis=-1))


def test_numpy_and_jax_decide_alike():
    rng = np.random.default_rng(2)
    scale = np.geomspace(3e-4, 3e-2, 40)[:, None]
    velocities = (rng.normal(size=(60, 40, 6)) * scale).astype(np.float32)
    shifts = rng.exponential(1e-3, (60, 40, 2)).astype(np.float32)
    tracks = []
    for xp in (np, jnp):

        def advance(track, velocity, shift, xp=xp):
            motion = stability.step_motion(xp, velocity, track.velocity, CONFIG)
            return stability.advance(xp, track, motion, shift, shift, CONFIG)

        advance = advance if xp is np else jax.jit(advance)
        track = stability.new_track(xp, (40,), 2, xp.float32)
        for velocity, shift in zip(velocities, shifts, strict=True):
            track = advance(track, velocity, shift)
        tracks.append(track)
    for ours, theirs in zip(*tracks, strict=True):
        np.testing.assert_allclose(ours, np.asarray(theirs), rtol=1e-5)
    verdicts = [
        stability.verdict_of_attempt(
            xp,
            track,
            is_focus=xp.asarray([[True, False]] * 40),
            is_neighbour=xp.asarray([[False, True]] * 40),
            is_below=xp.broadcast_to((xp.arange(40) % 7 == 0)[:, None], (40, 2)),
            penetrates=xp.arange(40) % 3 == 0,
            overflowed=xp.arange(40) % 11 == 0,
            is_finite=xp.arange(40) % 13 != 0,
            config=CONFIG,
        )
        for xp, track in zip((np, jnp), tracks, strict=True)
    ]
    np.testing.assert_array_equal(verdicts[0][0], verdicts[1][0])
    np.testing.assert_array_equal(verdicts[0][1], verdicts[1][1])
    assert verdicts[0][0].dtype == np.int32


@pytest.mark.parametrize(
    ("axis", "limit"),
    [(0, CONFIG.max_speed), (3, CONFIG.max_angular_speed)],
)
def test_a_step_is_quiet_below_its_speed_limit_only(axis, limit):
    for factor, expected in ((0.99, True), (1.01, False)):
        velocity = np.zeros(6)
        velocity[axis] = factor * limit
        assert stability.is_quiet_step(np, velocity, STILL, CONFIG) == expected


@pytest.mark.parametrize(
    ("axis", "limit"),
    [(0, CONFIG.max_acceleration), (3, CONFIG.max_angular_acceleration)],
)
def test_a_step_is_quiet_below_its_acceleration_limit_only(axis, limit):
    for factor, expected in ((0.99, True), (1.01, False)):
        acceleration = np.zeros(6)
        acceleration[axis] = -factor * limit
        assert stability.is_quiet_step(np, STILL, acceleration, CONFIG) == expected


def test_per_axis_compares_every_axis_alone():
    velocity = np.array([0.9, 0.9, 0.9, 0, 0, 0]) * CONFIG.max_speed
    assert not stability.is_quiet_step(np, velocity, STILL, CONFIG)
    assert stability.is_quiet_step(np, velocity, STILL, StabilityConfig(per_axis=True))
    velocity[1] = 1.1 * CONFIG.max_speed
    assert not stability.is_quiet_step(np, velocity, STILL, StabilityConfig(per_axis=True))


def test_twenty_quiet_steps_in_a_row_end_an_attempt():
    track = follow([STILL] * 100)
    assert (track.step, track.hold, bool(track.is_over), bool(track.is_quiet)) == (
        20,
        20,
        True,
        True,
    )


def test_one_loud_step_starts_the_count_again():
    # The step after the loud one is loud too: its acceleration is the velocity's fall.
    track = follow([STILL] * 19 + [FAST] + [STILL] * 100)
    assert (track.step, bool(track.is_quiet)) == (19 + 2 + 20, True)


@pytest.mark.parametrize(("num_loud", "expected"), [(39, Verdict.STABLE), (40, Verdict.UNSETTLED)])
def test_stable_means_quiet_by_step_sixty(num_loud, expected):
    # num_loud fast steps and the one in which the motion stops, then twenty quiet ones.
    for stop in (True, False):
        track = follow([FAST] * num_loud + [STILL] * 300, StabilityConfig(stop_when_decided=stop))
        assert judge(track)[0] == expected
        assert track.step == (60 if stop else num_loud + 21)


def test_an_attempt_that_never_rests_ends_where_it_is_decided_or_at_the_last_step():
    assert follow([FAST] * 300).step == CONFIG.decision_step == 60
    assert follow([FAST] * 300, StabilityConfig(stop_when_decided=False)).step == 240


def test_acceleration_is_the_difference_over_one_step():
    velocity = np.array([0.004, 0, 0, 0, 0, 0])
    track = follow([velocity, velocity])
    size = 0.004 * 240
    assert track.motion_sum == pytest.approx(0.004 + size + 0.004, rel=1e-6)
    assert track.speed_sum == pytest.approx(0.008, rel=1e-6)
    assert track.hold == 2  # 0.96 m/s^2 is quiet


def test_motion_sums_take_norms_over_six_numbers():
    velocity = np.array([1.0, -2, 3, -4, 5, -6])
    track = follow([velocity])
    assert track.speed_sum == pytest.approx(21)
    assert track.motion_sum == pytest.approx(np.sqrt(91) * 241, rel=1e-6)


def test_shift_is_the_farthest_on_the_way():
    shift = np.zeros((300, 2))
    shift[5] = (0.0, 0.0021)
    track = follow([STILL] * 300, shift=shift)
    assert judge(track) == (Verdict.DISPLACED, True)
    shift[5] = (0.0, 0.0019)
    assert judge(follow([STILL] * 300, shift=shift)) == (Verdict.STABLE, True)


def test_the_gravest_of_all_that_went_wrong_is_told():
    shift = np.full((300, 2), 1.0)
    track = follow([STILL] * 300, shift=shift)
    below = np.array([True, False])
    loud = follow([FAST] * 300, shift=shift)
    assert judge(loud)[0] == Verdict.DISPLACED
    assert judge(track, penetrates=np.array(True))[0] == Verdict.DISPLACED
    assert judge(track, is_below=below) == (Verdict.FELL, False)
    assert judge(track, is_below=below, overflowed=np.array(True)) == (Verdict.OVERFLOW, False)
    everything = {"is_below": below, "overflowed": np.array(True), "is_finite": np.array(False)}
    assert judge(track, **everything) == (Verdict.NON_FINITE, False)
    assert judge(follow([STILL] * 300), penetrates=np.array(True)) == (Verdict.PENETRATING, True)


def test_what_befalls_a_neighbour_counts_only_if_neighbours_are_judged():
    track = follow([STILL] * 300, shift=np.full((300, 2), 1.0))
    below = np.array([False, True])
    loose = StabilityConfig(judge_neighbours=False)
    assert judge(track, is_below=below) == (Verdict.FELL, True)
    assert judge(track, is_below=below, penetrates=np.array(True), config=loose) == (
        Verdict.STABLE,
        True,
    )
    assert judge(track, is_below=~below, config=loose) == (Verdict.FELL, False)


def test_a_pair_may_overlap_a_little_more_than_at_rest_but_never_much():
    def too_deep(now, before):
        return bool(stability.penetrates(np, np.array([now]), np.array([before]), CONFIG))

    assert not too_deep(0.0009, 0.0)
    assert too_deep(0.0011, 0.0)
    assert not too_deep(0.0014, 0.0005)
    assert too_deep(0.0016, 0.0005)
    assert too_deep(0.0021, 0.0019)


def test_the_last_check_is_staged():
    placed = np.array([True, False])

    def verdict(step, shift, turn=0.0, other=9.0):
        found = stability.verdict_of_scene(
            np, np.array(step), np.array([shift, other]), np.array([turn, other]), placed, CONFIG
        )
        return Verdict(int(found))

    assert verdict(59, 0.0) == Verdict.NONE
    assert verdict(60, 0.00009) == Verdict.STABLE
    assert verdict(60, 0.00011) == Verdict.NONE
    assert verdict(60, 0.0, np.radians(0.11)) == Verdict.NONE
    assert verdict(61, 0.0) == Verdict.NONE
    assert verdict(480, 0.0049, np.radians(4.9)) == Verdict.STABLE
    assert verdict(480, 0.0051) == Verdict.CREPT
    assert verdict(480, 0.0, np.radians(5.1)) == Verdict.CREPT


def test_below_top_looks_at_the_center_of_mass():
    # upright, and upside down
    poses = np.array([[[0, 0, 1.0, 1, 0, 0, 0], [0, 0, 1.0, 0, 1, 0, 0]]])
    center = np.array([[0, 0, 0.2], [0, 0, 0.2]])
    np.testing.assert_array_equal(below_top(np, poses, center, 1.1), [[False, True]])
    np.testing.assert_array_equal(below_top(np, poses, center, 0.7), [[False, False]])


def test_kept_clears_whole_scenes():
    array = np.full((3, 2, 2), np.nan)
    array[1] = 5
    np.testing.assert_array_equal(
        mask_scenes(np, array, np.array([False, True, False])),
        [np.zeros((2, 2)), array[1], np.zeros((2, 2))],
    )


@pytest.mark.parametrize(
    "changes",
    [{"max_speed": 0.0}, {"max_shift": float("nan")}, {"max_steps": 50}, {"quiet_steps": -1}],
)
def test_impossible_settings_are_refused(changes):
    with pytest.raises(ConfigError, match=next(iter(changes))):
        StabilityConfig(**changes)
