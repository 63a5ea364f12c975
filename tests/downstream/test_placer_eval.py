"""Placers side by side: figures are counted from verdicts, rows are kept, tables tell them."""

import json
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from scipy.ndimage import minimum_filter

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.downstream.placer.evaluation import bench as bench_module
from cluttergen_jax.downstream.placer.evaluation.bench import Bench, ProposalOutcomes
from cluttergen_jax.downstream.placer.evaluation.chain import Chains
from cluttergen_jax.downstream.placer.evaluation.tables import figures_of
from cluttergen_jax.downstream.placer.map_from_depth import QueryMaker
from cluttergen_jax.downstream.placer.pairs import maker as data
from cluttergen_jax.downstream.placer.pairs import store as pairs
from cluttergen_jax.downstream.placer.pairs.store import images_of, load_queries
from cluttergen_jax.downstream.placer.partial_scenes import PartialScenes
from cluttergen_jax.downstream.placer.proposers import GeometryPlacer
from cluttergen_jax.downstream.placer.query import Proposals, without_scores
from cluttergen_jax.downstream.placer.scene_cameras import SceneCameras
from cluttergen_jax.downstream.samples import SPLITS
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.placement.heightmap import VOID, HeightMapper
from cluttergen_jax.placement.search.search import CLEARANCE, SearchConfig
from cluttergen_jax.proportions import wilson
from cluttergen_jax.sensing.noise import NOISE_OFF, REALSENSE
from cluttergen_jax.sensing.partial import PartialMap, merged
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


def test_more_cameras_hide_less_and_take_nothing_away(seen):
    heights = {number: found[0].heights.height for number, found in seen.items()}
    ceilings = {number: found[0].ceilings.height for number, found in seen.items()}
    for few, many in ((1, 2), (2, 3)):
        # The second camera is the same whether there is a third or not.
        assert (heights[many] >= heights[few]).all()
        assert (ceilings[many] <= np.maximum(ceilings[few], heights[many])).all()
        assert (seen[many][1].unseen <= seen[few][1].unseen + 1e-6).all()
    assert seen[3][1].unseen.mean() < seen[1][1].unseen.mean()


def test_equal_seeds_give_equal_cameras(made, seen):
    again = load_queries(made, split="test", num_pairs=2, num_cameras=2)[0]
    assert np.array_equal(again.cloud, seen[2][0].cloud[:2])
    assert np.array_equal(again.ceilings.height, seen[2][0].ceilings.height[:2])


def test_no_ceiling_lies_below_what_stands(made, seen):
    queries, labels = seen[3]
    problem = made.setup("test").problem
    mapper, number = HeightMapper.of(problem.rules.geometry, problem.rules.region), len(labels.pair)
    poses, is_placed = np.zeros((number, 3, 7), np.float32), np.zeros((number, 3), bool)
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
            (ceilings.corner[0, k] + ceilings.cell[k] * (np.arange(cells) + 0.5) - true.corner[0, k])
            / true.cell[k]
        ).astype(int)
        for k, cells in enumerate(ceilings.height.shape[1:])
    )
    is_top = queries.heights.height > VOID
    assert (ceilings.height >= low[:, i][:, :, j] - 0.004)[is_top].all()


def test_a_query_of_two_cameras_is_their_two_maps_merged(made, seen):
    problem = made.setup("test").problem
    maker, cameras = QueryMaker(problem), SceneCameras(problem, "free")
    labels = seen[1][1]
    table = next(iter(made.tables("test")))
    names = list(problem.world.names)
    scenes = {scene.index: scene for scene in cg.read_bank(made.path.parent / "bank").scenes()}
    for row, first in enumerate(images_of(table, maker.T_world_region)):
        scene, number = scenes[int(labels.scene[row])], int(labels.num_standing[row])
        poses, is_placed = np.zeros((3, 7)), np.zeros(3, bool)
        for name, pose in list(zip(scene.objects, scene.poses, strict=True))[:number]:
            poses[names.index(name)], is_placed[names.index(name)] = pose, True
        (second,) = cameras.further(poses, is_placed, (SPLITS["test"], int(labels.pair[row])), 2)
        assert np.abs(second.camera.eye - first.camera.eye).max() > 0.01
        both = merged([PartialMap.of(*view, maker.grid) for view in (first, second)])
        # Poses of pairs are single precision, in another frame.
        wrong = np.abs(both.height - seen[2][0].heights.height[row]) > 1e-3
        assert wrong.mean() < 0.01


def test_each_camera_has_noise_of_its_own(made):
    problem = made.setup("test").problem
    maker = QueryMaker(problem)
    view = next(images_of(next(iter(made.tables("test"))), maker.T_world_region))
    one, again, two = (
        maker.see_all([view] * number, REALSENSE, np.random.default_rng(0)) for number in (1, 1, 2)
    )
    assert np.array_equal(one.heights, maker.see(*view, REALSENSE, np.random.default_rng(0)).heights)
    assert np.array_equal(one.heights, again.heights)
    assert (two.heights >= one.heights).all(), "the first camera's noise is as it was alone"
    assert not np.array_equal(two.heights, one.heights)
    exact = maker.see_all([view] * 2, NOISE_OFF, np.random.default_rng(0))
    np.testing.assert_array_equal(
        exact.heights, maker.see(*view, NOISE_OFF, np.random.default_rng(0)).heights
    )


def test_cameras_that_there_are_not_are_refused(made, tmp_path):
    with pytest.raises(ConfigError, match="cameras = 0"):
        cg.placer_eval(made.path, ("random",), cameras=0)
    bank = write_bank(tmp_path / "bank", 1, SPLITS["test"])
    above = cg.placer_data(tmp_path / "pairs", bank.path, camera="overhead", num_pairs=2)
    with pytest.raises(ConfigError, match="cameras = 2 of the camera 'overhead', of which there is one"):
        cg.placer_eval(above.path, ("random",), cameras=2)


@pytest.mark.slow
def test_rows_say_how_many_cameras_looked(made):
    found = cg.placer_eval(made.path, ("random",), noise=(0.0,), cameras=2)
    assert found.rows[0]["trial"]["cameras"] == 2
    assert "2 cameras free, fused" in str(found)


def test_where_the_scenes_own_object_rests_a_proposal_is_good_by_every_count(made, labels):
    bench = Bench(made.setup("test"), labels)
    yaw = 2 * np.arctan2(labels.target[:, 6], labels.target[:, 3])
    own = np.column_stack([labels.target[:, :3], yaw])
    own[:, 2] += CLEARANCE
    wrong = own + np.array([0.8, 0, 0, 0])
    pose = np.stack([wrong, own, own], axis=1).astype(np.float32)
    outcome = bench.judge(Proposals(pose, np.zeros(pose.shape[:2], np.float32)))
    assert (outcome.verdict[:, 0] != int(Verdict.STABLE)).all()
    assert (outcome.verdict[:, 1] == int(Verdict.STABLE)).all()
    assert (outcome.verdict[:, 2] == int(Verdict.NONE)).all(), "what follows a good one is not tried"
    high = bench.judge(Proposals(pose[:, 1:2] + np.float32([0, 0, 0.05, 0]), np.zeros((len(pose), 1))))
    assert high.z_error == pytest.approx(0.05, abs=0.001)
    good = bench.judge(Proposals(pose[:, 1:2], np.zeros((len(pose), 1), np.float32)))
    assert good.has_margin.all()
    assert good.is_quiet.all()
    assert bench.is_own_quiet().all()
    assert np.abs(good.z_error).max() < 0.001
    assert bench.stands_alone().all()


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
    known = labels._replace(num_standing=np.array([0, 0, 1, 1, 7, 8]), unseen=np.linspace(0, 1, number))
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


def test_rows_are_kept_and_told_in_a_table(made, tmp_path, capsys, monkeypatch):
    words = ["placer", "eval", str(made.path), "--placers", "random", "geometry", "--noise", "0"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    rows = json.loads((tmp_path / "results.json").read_text())
    assert [row["trial"]["placer"] for row in rows] == ["random", "geometry"]
    assert "6 queries of" in told
    # On a table with two objects at most, who looks always finds room.
    assert rows[1]["figures"]["success"]["share"] == 1
    monkeypatch.setattr(Bench, "judge", None)
    again = cg.placer_eval(made.path, ("random", "geometry"), noise=(0.0,), out=tmp_path)
    assert [row["figures"] for row in again.rows] == [row["figures"] for row in rows]
    stored = sorted((tmp_path / "results").glob("*.npz"))
    assert len(stored) == 2
    with np.load(stored[0]) as arrays:
        assert arrays["pose"].shape == (6, 5, 4)
        assert arrays["verdict"].shape == (6, 5)


@pytest.mark.slow
def test_methods_that_see_the_scene_fill_the_table_and_say_so(made):
    found = cg.placer_eval(made.path, ("drop", "guided"), noise=(0.0,))
    assert [row["figures"]["success"]["share"] for row in found.rows] == [1, 1]
    assert "drop (full state)" in str(found)
    assert "guided (full state)" in str(found)


@pytest.mark.slow
def test_a_chain_fills_a_table_by_what_the_camera_sees(tmp_path):
    scenes = PartialScenes(write_bank(tmp_path / "bank", 2, SPLITS["test"]))
    made = Chains(scenes, 5, "overhead", NOISE_OFF, seed=0)
    found = made.run(GeometryPlacer("occupied", SearchConfig(64, 16, 8)))
    assert made.num_chains == 2
    assert found["success"]["share"] == 1
    assert found["placed"] == 3
    assert [each["standing"] for each in found["by_slot"]] == [0, 1, 2]
    # Who lets everything go at one place gets no farther than the first object.
    stubborn = made.run(OnePlace())
    assert stubborn["success"]["share"] == 0
    assert stubborn["placed"] == 1
    assert stubborn["by_slot"][1] == {"standing": 1, "chains": 2, "share": 0.0}


class OnePlace(struct.PyTreeNode):
    """Proposes the middle of the table, five times."""

    def __call__(self, key, query):
        return without_scores(
            jnp.tile(jnp.array([0.0, 0.0, 0.001, 0.0]).at[2].add(query.half_extents[2]), (5, 1))
        )


def test_what_cannot_be_compared_is_refused(made, tmp_path):
    with pytest.raises(ConfigError, match="placer 'nobody'"):
        cg.placer_eval(made.path, ("random", "nobody"))
    for noise in ((-1.0,), (), 1.0, "1", ("1",), (float("nan"),)):
        with pytest.raises(ConfigError, match="noise = "):
            cg.placer_eval(made.path, noise=noise)
    for given in ({"num_pairs": 0}, {"seed": -1}):
        with pytest.raises(ConfigError, match=next(iter(given))):
            cg.placer_eval(made.path, ("random",), **given)
    with pytest.raises(ConfigError, match="no pairs of the split 'val'"):
        cg.placer_eval(made.path, split="val")
    with pytest.raises(ConfigError, match="a sequence of names"):
        cg.placer_eval(made.path, "geometry")
    with pytest.raises(ConfigError, match="does not hold the bank behind 'test'"):
        cg.placer_eval(made.path, ("random",), chains=2)
    with pytest.raises(BankError, match="holds no pairs"):
        cg.placer_eval(tmp_path)


def test_errors_of_an_action_speak_of_its_flags(made, capsys):
    assert main(["placer", "eval", str(made.path), "--noise", "99"]) == 2
    assert "--noise 99.0" in capsys.readouterr().err
