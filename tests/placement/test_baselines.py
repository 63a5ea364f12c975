"""The baselines against independent geometry: polygons, rays and MuJoCo's own contacts."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapely import MultiPoint, unary_union
from shapely.geometry import Polygon
from shapely.geometry import box as rectangle

from cluttergen_jax.placement.config import PlacementConfig
from cluttergen_jax.placement.heightmap import HeightMapper
from cluttergen_jax.placement.methods.table import make_proposer
from cluttergen_jax.placement.problem import Problem, ProblemConfig, make_problem
from cluttergen_jax.placement.region import pose_of_action
from cluttergen_jax.placement.rollout import BlockSampler
from tests.helpers.problems import made_up_rules

TOP = 0.7
CLEARANCE = 0.001


@dataclass(frozen=True)
class Proposal:
    """One proposal in a scene: what stood there, and where which object was to go."""

    poses: np.ndarray
    is_placed: np.ndarray
    focus: int
    proposed: np.ndarray


def play(problem: Problem, method: str, num_scenes: int, num_steps: int) -> list[Proposal]:
    """What a method proposes in dining-table scenes that it fills itself, on the real physics."""
    rules = problem.rules
    propose = make_proposer(method, problem.rules)
    sampler = BlockSampler(rules, propose)
    indices = jnp.arange(num_scenes)
    episodes = jax.jit(sampler.begin)(jax.random.key(7), indices, indices >= 0)

    @jax.jit
    def step(episodes):
        keys = jax.vmap(jax.random.split)(episodes.key)
        actions = jax.vmap(propose)(keys[:, 0], episodes)
        proposed = jax.vmap(pose_of_action)(
            actions, episodes.region, jax.vmap(rules.height_range)(episodes)
        )
        after = jax.vmap(rules.attempt)(episodes.replace(key=keys[:, 1]), actions)[0]
        return after, (jax.vmap(rules.focus)(episodes), proposed)

    proposals = []
    for _ in range(num_steps):
        before = jax.tree.map(np.asarray, (episodes.poses, episodes.is_placed, episodes.is_over))
        episodes, (focus, proposed) = step(episodes)
        for i in np.flatnonzero(~before[2]):
            proposals.append(
                Proposal(before[0][i], before[1][i], int(focus[i]), np.asarray(proposed[i]))
            )
    return proposals


@pytest.fixture(scope="module")
def dining() -> Problem:
    return dining_on("table")


def dining_on(support: str) -> Problem:
    return make_problem(
        ProblemConfig(pool="dining", support=support, placement=PlacementConfig(history_stride=0))
    )


@pytest.fixture(scope="module")
def crowded() -> tuple[Problem, list[Proposal]]:
    """A small table that `drop` fills with ten things, on top of one another where it must."""
    problem = dining_on("table-0.32x0.42")
    return problem, play(problem, "drop", 12, 12)


def footprint(problem: Problem, index: int, pose: np.ndarray) -> Polygon:
    """The union of the parts' shadows, from their own vertices."""
    turn = Rotation.from_quat(np.roll(pose[3:], -1)).as_matrix()
    parts = problem.world.objects[index].parts
    return unary_union(
        [MultiPoint((part.vertices @ turn.T + pose[:3])[:, :2]).convex_hull for part in parts]
    )


def data_of(problem: Problem, poses: np.ndarray, is_placed: np.ndarray) -> mujoco.MjData:
    """MuJoCo's own view of a scene."""
    layout = problem.world.layout
    data = mujoco.MjData(layout.model)
    qpos = layout.parked
    qpos[is_placed] = poses[is_placed]
    data.qpos[:] = qpos.ravel()
    mujoco.mj_forward(layout.model, data)
    return data


def test_clear_keeps_clear_of_every_footprint_and_of_the_edges(dining: Problem) -> None:
    """Where a whole clear place is left, which is nearly always: the plate may come when there is none."""
    table = rectangle(-0.3, -0.35, 0.3, 0.35).buffer(0.004)
    proposals = play(dining, "clear", 8, 10)
    assert len(proposals) > 70
    overlaps = [overlap(dining, proposal) for proposal in proposals]
    is_whole = [
        table.contains(footprint(dining, proposal.focus, proposal.proposed))
        for proposal in proposals
    ]
    is_clear = (np.array(overlaps) < 1e-9) & np.array(is_whole)
    assert is_clear.mean() > 0.95
    # A proposal that is not clear is one of the last resort, for the largest thing.
    plate = dining.world.names.index("dinner_plate")
    assert {
        proposal.focus for proposal, clear in zip(proposals, is_clear, strict=True) if not clear
    } <= {plate}


def overlap(problem: Problem, proposal: Proposal) -> float:
    """Square metres of the proposed footprint over placed ones."""
    mine = footprint(problem, proposal.focus, proposal.proposed)
    others = np.flatnonzero(proposal.is_placed)
    return sum(mine.intersection(footprint(problem, k, proposal.poses[k])).area for k in others)


@pytest.mark.slow
def test_the_map_covers_what_rays_hit_and_little_else(
    crowded: tuple[Problem, list[Proposal]],
) -> None:
    problem, proposals = crowded
    fullest = max(proposals, key=lambda proposal: proposal.is_placed.sum())
    assert fullest.is_placed.sum() >= 8
    region = problem.rules.region
    mapper = jax.jit(HeightMapper.of(problem.rules.geometry, region).__call__)
    heights = mapper(region, fullest.poses, fullest.is_placed)
    hits = ray_heights(problem, data_of(problem, fullest.poses, fullest.is_placed), heights)
    mapped = np.asarray(heights.height)[1:-1, 1:-1]
    middle = hits[:, :, 1, 1]
    # On a steep flank a cell's centre may lie uphill of the nearest point: rarely, and by less than a cell.
    assert np.mean(mapped >= middle - 0.0015) > 0.998
    assert np.all(mapped >= spread(np.min, middle, 1) - 0.0015)
    # Grown by 4 mm and cut into cells of 7 mm, a surface reaches two cells at most; rays may miss a tip.
    assert np.mean(mapped <= spread(np.max, hits.max((2, 3)), 2) + 0.004) > 0.998
    assert 0.05 < np.mean(mapped == 0) < 0.9


def spread(join, hits: np.ndarray, reach: int) -> np.ndarray:
    """The lowest or highest of the hits up to `reach` cells away."""
    padded = np.pad(hits, reach, mode="edge")
    steps = range(-reach, reach + 1)
    shifted = [np.roll(padded, (i, j), (0, 1)) for i in steps for j in steps]
    return join(shifted, axis=0)[reach:-reach, reach:-reach]


def ray_heights(problem: Problem, data: mujoco.MjData, heights) -> np.ndarray:
    """f64[W, H, 3, 3]: what vertical rays hit, above the top: nine in each cell but those of the border."""
    model = problem.world.layout.model
    shape = heights.height.shape
    corner = np.asarray(heights.corner)
    cell = heights.cell
    hits = np.empty((shape[0] - 2, shape[1] - 2, 3, 3))
    geom = np.zeros(1, np.int32)
    start = 3.0
    for i, j, k, m in np.ndindex(hits.shape):
        x, y = corner + (np.array([i, j]) + 1 + (np.array([k, m]) + 0.5) / 3) * cell
        distance = mujoco.mj_ray(
            model, data, np.array([x, y, start]), np.array([0.0, 0, -1]), None, 1, -1, geom
        )
        hits[i, j, k, m] = start - distance - TOP
    return hits


def test_drop_lets_things_down_onto_what_is_there(crowded: tuple[Problem, list[Proposal]]) -> None:
    """At release hardly anything overlaps, and the first contact is close below, on flat things exactly."""
    problem, proposals = crowded
    assert all(
        proposal.is_placed.any() or on_top(problem, proposal) < 2e-6 for proposal in proposals
    )
    stacked = [proposal for proposal in proposals if on_top(problem, proposal) > 0.002][:20]
    assert len(stacked) >= 8
    falls = []
    for proposal in stacked:
        fall = -0.001
        while fall < 0.03 and not touches(problem, proposal, fall):
            fall += 0.0005
        falls.append(fall)
    # Under-sides are known at points a few millimetres apart, so a slope may be met a little early.
    assert min(falls) > -0.001
    assert np.mean(np.array(falls) > 0) > 0.8
    assert np.median(falls) < 0.004
    assert max(falls) < 0.015


def on_top(problem: Problem, proposal: Proposal) -> float:
    """Metres by which a proposal is higher than on the bare top."""
    half = problem.world.objects[proposal.focus].half_extents[2]
    return float(proposal.proposed[2] - TOP - half - CLEARANCE)


def touches(problem: Problem, proposal: Proposal, fall: float) -> bool:
    """Whether the proposed object, lowered by `fall`, overlaps anything, says MuJoCo."""
    poses = proposal.poses.copy()
    is_placed = proposal.is_placed.copy()
    poses[proposal.focus] = proposal.proposed
    poses[proposal.focus, 2] -= fall
    is_placed[proposal.focus] = True
    data = data_of(problem, poses, is_placed)
    owner = problem.world.layout.geom_object
    return any(
        proposal.focus in owner[contact.geom] and contact.dist < 0
        for contact in (data.contact[i] for i in range(data.ncon))
    )


def test_a_free_height_has_nothing_to_do_with_the_place():
    rules = made_up_rules(height="free")
    episode = rules.begin(jax.random.key(0))
    propose = make_proposer("random", rules)
    keys = jax.random.split(jax.random.key(1), 2000)
    actions = np.asarray(jax.jit(jax.vmap(lambda key: propose(key, episode)))(keys))
    assert np.abs(np.corrcoef(actions.T) - np.eye(4)).max() < 0.1
    np.testing.assert_allclose(actions.mean(0), 0.5, atol=0.03)
