"""Placers side by side: figures are counted from verdicts, rows are kept, tables tell them."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
from scipy.ndimage import minimum_filter

import cluttergen_jax as cg
from cluttergen_jax.downstream.placer import bench as bench_module
from cluttergen_jax.downstream.placer import pair_maker as data
from cluttergen_jax.downstream.placer import pairs
from cluttergen_jax.downstream.placer.bench import ProposalOutcomes
from cluttergen_jax.downstream.placer.evaluate import figures_of
from cluttergen_jax.downstream.placer.pairs import load_queries
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.placement.heightmap import VOID, HeightMapper
from cluttergen_jax.statistics import wilson
from cluttergen_jax.types import Verdict
from tests.helpers.placing import write_bank


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        for module in (data, pairs):
            patch.setattr(module, "PAIRS", replace(pairs.PAIRS, block_size=8))
        patch.setattr(pairs.PairSet, "form", pairs.PAIRS)
        patch.setattr(bench_module, "_AT_ONCE", 8)
        folder = tmp_path_factory.mktemp("placer")
        found = write_bank(folder / "bank", seed=SPLITS["test"])
        yield cg.placer_data(folder / "pairs", found.path, num_pairs=6)


@pytest.fixture(scope="module")
def labels(made):
    return load_queries(made, split="test")[1]


@pytest.fixture(scope="module")
def seen(made):
    """Queries by number of cameras, without noise."""
    return {number: load_queries(made, split="test", num_cameras=number) for number in (1, 2, 3)}


def test_no_ceiling_lies_below_what_stands(made, seen):
    queries, labels = seen[3]
    problem = made.setup("test").problem
    mapper = HeightMapper.of(problem.rules.geometry, problem.rules.region)
    number = len(labels.pair)
    poses = np.zeros((number, 3, 7), np.float32)
    is_placed = np.zeros((number, 3), bool)
    for row, standing in enumerate(labels.num_standing):
        at = row, labels.order[row, :standing]
        poses[at] = labels.poses[row, :standing] + [0, 0, problem.world.support.top, 0, 0, 0, 0]
        is_placed[at] = True
    true = jax.jit(jax.vmap(partial(mapper, problem.rules.region)))(poses, is_placed)
    # Its cells are finer: the lowest of those within one of the query's.
    low = minimum_filter(np.asarray(true.height), (1, 5, 5))
    assert low.max() > 0.03
    ceilings = queries.ceilings
    i, j = (
        (
            (
                ceilings.corner[0, k]
                + ceilings.cell[k] * (np.arange(cells) + 0.5)
                - true.corner[0, k]
            )
            / true.cell[k]
        ).astype(int)
        for k, cells in enumerate(ceilings.height.shape[1:])
    )
    is_top = queries.heights.height > VOID
    assert (ceilings.height >= low[:, i][:, :, j] - 0.004)[is_top].all()


def test_figures_are_shares_of_verdicts_with_wilsons_intervals(labels):
    number = len(labels.pair)
    verdict = np.full((number, 2), int(Verdict.NONE))
    verdict[:, 0] = [0, 0, 0, int(Verdict.DISPLACED), int(Verdict.UNSETTLED), int(Verdict.CREPT)]
    verdict[3:, 1] = [0, 0, int(Verdict.PENETRATING)]
    outcome = ProposalOutcomes(
        pose=np.zeros((number, 2, 4)),
        score=np.array([[0.9, 0.1]] * 3 + [[0.3, 0.1]] * 3),
        verdict=verdict,
        has_margin=np.arange(number) < 2,
        is_quiet=np.arange(number) < 4,
        z_error=np.array([0.0, -0.001, 0.002, 0.003, 0.004, np.nan]),
    )
    known = labels._replace(
        num_standing=np.array([0, 0, 1, 1, 7, 8]), unseen=np.linspace(0, 1, number)
    )
    figures = figures_of(outcome, known, ("box", "prism", "tall"))
    low, high = wilson(3, 6)
    assert figures["success"] == {"share": 0.5, "low95": low, "high95": high}
    assert figures["best_of_all"]["share"] == pytest.approx(5 / 6)
    assert figures["with_margin"]["share"] == pytest.approx(1 / 3)
    assert figures["paper"]["share"] == pytest.approx(2 / 3)
    assert figures["verdicts"]["displaced"] == figures["verdicts"]["crept"] == pytest.approx(1 / 6)
    assert figures["z_error"]["median"] == pytest.approx(0.002)
    assert figures["many"]["queries"] == 2
    assert figures["many"]["share"] == 0
    assert [each["queries"] for each in figures["by_standing"]] == [2, 2, 1, 1]
    assert sum(each["queries"] for each in figures["by_unseen"]) == number
    assert sum(each["queries"] for each in figures["by_object"]) == number
    assert figures["calibration"]["brier"] == pytest.approx((3 * 0.1**2 + 3 * 0.3**2) / 6)
    assert figures["calibration"]["gap"] == pytest.approx(0.5 * 0.1 + 0.5 * 0.3)


def on_the_left(rng, query):
    """A placer of NumPy: at the bare height, somewhere in the left half."""
    half = query.region_half_extents
    xy = rng.uniform([-half[0], -half[1]], [0.0, half[1]], (3, 2))
    return np.column_stack([xy, np.full(3, query.half_extents[2] + 0.002), np.zeros(3)])


@pytest.mark.slow
def test_a_placer_of_ones_own_is_evaluated_beside_others(made, tmp_path):
    found = cg.placer_eval(
        made.path, (on_the_left, "random"), noise=(0.0,), out=tmp_path, num_pairs=3
    )
    assert [row["trial"]["placer"] for row in found.rows] == ["on_the_left", "random"]
    (stored,) = (each for each in tmp_path.rglob("*.npz") if "left" in each.name)
    with np.load(stored) as arrays:
        pose = arrays["pose"]
    assert pose.shape == (3, 3, 4)
    assert (pose[..., 0] <= 0).all()
    again = cg.placer_eval(made.path, (on_the_left,), noise=(0.0,), out=tmp_path, num_pairs=3)
    assert again.rows == found.rows[:1]
    numbers = iter((1, 2, 1))
    with pytest.raises(ConfigError, match="returned 1 to 2 proposals"):
        cg.placer_eval(
            made.path, (lambda rng, query: np.zeros((next(numbers), 4)),), noise=(0.0,), num_pairs=3
        )
    with pytest.raises(ConfigError, match="placers of one name: on_the_left"):
        cg.placer_eval(made.path, (on_the_left, on_the_left), noise=(0.0,))
