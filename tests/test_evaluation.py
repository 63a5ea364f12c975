"""Evaluation: trials and their figures, results that are kept, changed regions, suites, reports."""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.support_file import list_supports
from cluttergen_jax.cli import evaluation as command
from cluttergen_jax.cli.evaluate import Evaluate
from cluttergen_jax.cli.main import run
from cluttergen_jax.config import StabilityConfig
from cluttergen_jax.errors import ConfigError, MissingExtraError, PoolError
from cluttergen_jax.evaluation import measuring, published
from cluttergen_jax.evaluation.checkpoints import Checkpoints, MissingCheckpointError
from cluttergen_jax.evaluation.document import document, read_results
from cluttergen_jax.evaluation.episodes import Attempts, attempts_of, run_episodes
from cluttergen_jax.evaluation.lab import Lab
from cluttergen_jax.evaluation.layouts import LAYOUTS
from cluttergen_jax.evaluation.measuring import MEASURES
from cluttergen_jax.evaluation.plots import at_least
from cluttergen_jax.evaluation.progress import Progress
from cluttergen_jax.evaluation.proportion import spread_of, wilson
from cluttergen_jax.evaluation.record import figures_of, steps_by_attempt
from cluttergen_jax.evaluation.report import tables_of
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.studies import run_study
from cluttergen_jax.evaluation.suites import FURNITURE, SUITES, Scale, Study, find_suite
from cluttergen_jax.evaluation.tables import Table
from cluttergen_jax.evaluation.trial import Trial, key_of
from cluttergen_jax.measures.simulate import no_movement
from cluttergen_jax.placement.changes import CHANGES, draw_region, find_change
from cluttergen_jax.policies.embedded import list_policies
from cluttergen_jax.sampling import BlockSampler, Rollout, sample_blocks
from tests.problems import HalfTable, made_up_rules

DOCS = Path(__file__).parent.parent / "docs"
SMALL = Trial(num_objects=2, trials=6)


@jax.tree_util.Partial
def uniform(key, episode):
    return jax.random.uniform(key, (4,))


@pytest.mark.parametrize(("successes", "trials"), [(0, 8), (8, 8), (3, 7), (412, 1000)])
def test_intervals_are_wilsons(successes, trials):
    interval = scipy.stats.binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson(successes, trials) == pytest.approx((interval.low, interval.high), abs=1e-6)


def test_nothing_tried_says_nothing():
    assert wilson(0, 0) == (0.0, 1.0)
    assert spread_of(np.zeros(0))["mean"] is None


# Queried regions


def draws(name, base, bounds, number=400):
    keys = jax.random.split(jax.random.key(7), number)
    region = jax.vmap(lambda key: draw_region(key, find_change(name), base, bounds, 0.7))(keys)
    pose = np.asarray(region.T_world_region.wxyz_xyz, np.float64)
    return pose[:, 4:6], np.asarray(region.half_extents, np.float64), 2 * np.arctan2(pose[:, 3], pose[:, 0])


def corners_of(center, half, yaw):
    signs = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
    turn = np.stack([np.stack([np.cos(yaw), np.sin(yaw)], -1), np.stack([-np.sin(yaw), np.cos(yaw)], -1)], 1)
    return center[:, None] + (signs * half[:, None]) @ turn


BASE, LARGE = Rectangle(half_extents=(0.30, 0.35)), Rectangle(half_extents=(0.70, 0.70))


@pytest.mark.parametrize("name", CHANGES)
def test_changed_regions_stay_in_their_ranges(name):
    change, far = CHANGES[name], Rectangle(half_extents=(9.0, 9.0))
    center, half, yaw = draws(name, BASE, far)
    yaw = np.mod(yaw + np.pi, 2 * np.pi) - np.pi
    growth = half - np.array(BASE.half_extents)
    for values, low, high in (
        (center, -change.translation, change.translation),
        (yaw, -change.rotation, change.rotation),
        (growth, -change.shrinkage, change.expansion),
    ):
        assert values.min() >= low - 1e-6
        assert values.max() <= high + 1e-6
        # Four hundred uniform draws come close to both ends of their range.
        assert np.ptp(values) >= 0.95 * (high - low)


@pytest.mark.parametrize(
    "bounds", [LARGE, Rectangle((0.1, -0.2), (0.6, 0.21), 0.4), Rectangle((0.0, 0.0), (0.24, 0.24))]
)
def test_changed_regions_stay_on_their_table(bounds):
    base = BASE if bounds is LARGE else bounds
    corners = corners_of(*draws("all", base, bounds)) - np.array(bounds.center)
    cos, sin = np.cos(bounds.yaw), np.sin(bounds.yaw)
    local = corners @ np.array([[cos, -sin], [sin, cos]])
    assert (np.abs(local) <= np.array(bounds.half_extents) + 1e-5).all()


def test_turned_regions_keep_the_most_area():
    bounds = Rectangle(half_extents=(0.75, 0.325))
    _, half, yaw = draws("rotation", bounds, bounds)
    cos, sin = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
    # Across the table nothing is left of the long side but the table's depth; the short side stays.
    across = cos < 0.02
    assert across.any()
    np.testing.assert_allclose(half[across], [[0.325, 0.325]] * across.sum(), rtol=0.05)
    for k in range(0, len(half), 20):
        a, b = np.meshgrid(np.linspace(0.001, 0.75, 400), np.linspace(0.001, 0.325, 400))
        fits = (cos[k] * a + sin[k] * b <= 0.75) & (sin[k] * a + cos[k] * b <= 0.325)
        assert half[k].prod() >= 0.99 * (a * b)[fits].max()


def test_unknown_change_is_named():
    with pytest.raises(ConfigError, match="translation"):
        Trial(change="tilt")


# Episodes and figures


@pytest.fixture(scope="module")
def made_up():
    """A sampler over the made-up physics, and twenty of its episodes."""
    sampler = BlockSampler(made_up_rules(history_stride=0), uniform)
    return sampler, run_episodes(Rollout(attempts_of), sampler, 20, seed=3)


def test_logged_episodes_are_the_samplers(made_up):
    sampler, outcome = made_up
    _, _, plain = next(sample_blocks(sampler, [(0, 20)], 3))
    for ours, theirs in zip(jax.tree.leaves(outcome.scenes), jax.tree.leaves(plain), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    attempts, counts = outcome.attempts, outcome.scenes.counts
    assert attempts.is_made.all()
    assert len(attempts.scene) == counts.attempts.sum()
    np.testing.assert_array_equal(
        np.bincount(attempts.scene, attempts.steps, minlength=20), counts.steps.sum(1)
    )
    assert attempts.is_stable.sum() == outcome.scenes.is_placed.sum()


def test_figures_by_hand(made_up):
    outcome = made_up[1]
    figures, scenes = figures_of(outcome), outcome.scenes
    assert figures["success"] == scenes.is_success.mean()
    assert figures["placed"] == pytest.approx(np.dot(figures["placed_histogram"], range(5)) / 20)
    assert figures["attempts"] == sum(figures["verdicts"].values())
    assert figures["rest_steps"]["mean"] == 23
    loose = figures_of(outcome, has_last_check=False)
    assert loose["success"] == scenes.is_filled.mean()
    shares = at_least(figures["placed_histogram"])
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == figures["filled"]
    json.dumps(figures, allow_nan=False)


def test_steps_count_placements_that_took_three_attempts():
    # Scene 0: slot 0 stands at once, slot 1 at its third attempt; scene 1: slot 0 never stands.
    rows = [(0, 0, 1, 20, 1), (0, 1, 1, 240, 0), (0, 1, 2, 100, 0), (0, 1, 3, 30, 1)]
    rows += [(1, 0, ordinal, 240, 0) for ordinal in range(1, 6)]
    scene, slot, ordinal, steps, stable = np.array(rows).T
    blank = np.zeros(len(rows))
    attempts = Attempts(scene, slot, blank, ordinal, steps, stable > 0, blank, blank > -1)
    assert [(each["attempt"], each["count"], each["mean"]) for each in steps_by_attempt(attempts)] == [
        (1, 1, 240.0),
        (2, 1, 100.0),
        (3, 1, 30.0),
    ]


class SlowTable(HalfTable):
    """Attempts that fail take 240 steps."""

    def settle(self, poses, is_placed, focus, is_active):
        result = super().settle(poses, is_placed, focus, is_active)
        return result.replace(num_steps=jnp.where(result.num_steps == 60, 240, result.num_steps))


def test_whole_attempts_count_all_steps_and_the_history_tells_what_decided():
    whole = SlowTable(StabilityConfig(stop_when_decided=False))
    cut = made_up_rules(history_stride=12)
    patient = dataclasses.replace(cut, physics=whole, history_steps=whole.config.decision_step)
    assert patient.history_rows == cut.history_rows
    fails = jnp.array([0.1, 0.5, 0.1, 0.5])
    after, expected = (
        jax.jit(lambda key, rules=rules: rules.attempt(rules.begin(key), fails)[0])(jax.random.key(0))
        for rules in (patient, cut)
    )
    assert int(after.counts.steps[0]) == 240
    assert int(expected.counts.steps[0]) == 60
    for ours, theirs in zip(jax.tree.leaves(after.history), jax.tree.leaves(expected.history), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_finished_episodes_make_no_attempt(made_up):
    sampler, is_wanted = made_up[0], np.array([True, False, True])
    _, attempts = jax.jit(lambda key: sampler.step(sampler.begin(key, np.arange(3), is_wanted)))(
        jax.random.key(0)
    )
    assert attempts.is_made.tolist() == [True, False, True]


# Results on disk


def test_keys_follow_content():
    sources = {"pool": "a", "checkpoint": None}
    assert key_of(SMALL, sources) == key_of(dataclasses.replace(SMALL), dict(sources))
    others = [dataclasses.replace(SMALL, seed=1), dataclasses.replace(SMALL, attempts=4)]
    keys = {key_of(each, sources) for each in [SMALL, *others]} | {key_of(SMALL, sources | {"pool": "b"})}
    assert len(keys) == 4
    # A pool that lies elsewhere is the same pool: its hash is among the sources.
    assert key_of(dataclasses.replace(SMALL, pool="copy/of/dining"), sources) == key_of(SMALL, sources)


def test_store_sets_damaged_files_aside(tmp_path):
    said = []
    store = Store(tmp_path, said.append)
    assert store.read("row", "k") is None
    store.write("row", "k", {"figures": {"success": 1.0}}, {"poses": np.ones(3)})
    assert store.read("row", "k")["figures"] == {"success": 1.0}
    np.testing.assert_array_equal(store.read_arrays("row", "k")["poses"], np.ones(3))
    for path in (store.path("row", "k"), store.path("row", "k").with_suffix(".npz")):
        path.write_bytes(path.read_bytes()[:20])
    assert store.read("row", "k") is None
    assert store.read_arrays("row", "k") is None
    assert len(said) == 2
    assert len(list(tmp_path.glob("*.damaged"))) == 2


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return Lab(Store(tmp_path_factory.mktemp("results")))


def test_rows_are_kept_with_both_counts(lab):
    trial = dataclasses.replace(SMALL, paper_count=True, whole_attempts=True)
    record = lab.record(trial)
    assert lab.record(trial) == record == lab.at_hand(trial)
    figures = record["figures"]
    assert figures["paper"]["trials"] == figures["trials"] == 6
    # Nothing is judged less strictly than the paper's count, and two objects never fail it here.
    assert figures["paper"]["success"] >= figures["success"]
    arrays = lab.arrays(trial)
    assert arrays["is_success"].mean() == figures["success"]
    assert arrays["poses"].shape == (6, 2, 7)


def test_whole_attempts_change_steps_and_no_verdict(lab):
    cut, whole = lab.run(SMALL), lab.run(dataclasses.replace(SMALL, whole_attempts=True))
    np.testing.assert_array_equal(cut.scenes.is_success, whole.scenes.is_success)
    np.testing.assert_array_equal(cut.scenes.T_world_object, whole.scenes.T_world_object)
    assert (cut.scenes.counts.steps <= whole.scenes.counts.steps).all()
    assert cut.attempts.steps.max() <= 60


def test_changed_regions_are_where_objects_go(lab):
    trial = dataclasses.replace(SMALL, support="table-1.40x1.40", region=(0.2, 0.2), change="translation")
    episode = lab.problem(trial).rules.begin(jax.random.key(4))
    center = np.asarray(episode.region.T_world_region.translation())[:2]
    assert 0 < np.abs(center).max() <= 0.15
    np.testing.assert_allclose(episode.region.half_extents, [0.1, 0.1], atol=1e-6)


def test_missing_checkpoints_are_rows_of_their_own(lab, tmp_path):
    trial = dataclasses.replace(SMALL, method="policy", pool="study", training_seed=41)
    record = lab.record(trial)
    assert "no checkpoint" in record["missing"]
    assert record["hint"] == "cluttergen train --pool study --variant policy --seed 41 --num-objects 2"
    other = dataclasses.replace(trial, training_seed=0, attempts=3)
    # A folder of runs hides what is embedded.
    elsewhere = Lab(Store(tmp_path / "runs"), Checkpoints(folder=tmp_path))
    assert "--attempts 3 --out runs/study-policy-attempts3-0" in elsewhere.record(other)["hint"]
    # A given checkpoint is no other method's.
    given = Lab(Store(tmp_path / "given"), Checkpoints(path=list_policies()["dining-normal"]))
    assert given.checkpoints.find(dataclasses.replace(SMALL, method="policy-clear")) is not None
    with pytest.raises(MissingCheckpointError, match="trained as 'normal'"):
        given.checkpoints.find(dataclasses.replace(SMALL, method="policy"))
    with pytest.raises(ConfigError, match="folder of training runs"):
        Checkpoints(folder=tmp_path / "nowhere")


def test_checkpoints_are_found_by_pool_variant_and_seed(tmp_path):
    record = {
        "format": 1,
        "placement": {"max_attempts": 5, "history_stride": 12},
        "stability": {"stop_when_decided": True},
    }
    for name in ("dining-policy-0/policy", "dining-policy-1/policy", "dining-normal"):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        (folder / "record.json").write_text(json.dumps(record))
        (folder / "weights.npz").write_bytes(b"weights")
    found = Checkpoints(folder=tmp_path)
    policy = dataclasses.replace(SMALL, method="policy")
    assert found.find(policy) == tmp_path / "dining-policy-0/policy"
    assert found.find(dataclasses.replace(policy, training_seed=1)) == tmp_path / "dining-policy-1/policy"
    assert found.find(dataclasses.replace(policy, method="normal")) == tmp_path / "dining-normal"
    with pytest.raises(MissingCheckpointError):
        found.find(dataclasses.replace(policy, training_seed=2))
    other = dataclasses.replace(policy, attempts=2)
    assert found.find(other) == tmp_path / "dining-policy-0/policy"
    (tmp_path / "dining-policy-0").rename(tmp_path / "dining-policy-attempts2-0")
    assert found.find(other) == tmp_path / "dining-policy-attempts2-0/policy"
    # What cannot be used is said in the row, and the suite goes on.
    record = Lab(Store(tmp_path / "results"), found).record(other)
    assert "cannot be used" in record["missing"]
    assert str(tmp_path) not in record["missing"]


# Suites and reports


@pytest.mark.parametrize("suite", SUITES)
def test_suites_name_what_exists(suite):
    studies = find_suite(suite, Scale())
    names = [study.name for study in studies]
    assert len(set(names)) == len(names)
    for study in studies:
        assert (study.layout or study.name) in LAYOUTS
        assert study.measure in ("", *MEASURES)
        assert study.trials
    quick = find_suite(suite, Scale(quick=True))
    assert all(t.trials <= 16 for study in quick for t in study.trials)
    assert [study.name for study in find_suite(suite, Scale(), (names[-1],))] == names[-1:]


def test_suites_ask_what_the_paper_asked():
    studies = {study.name: study.trials for study in find_suite("paper", Scale())}
    assert {t.pool for t in studies["table1"]} == set(published.GROUP_OF_POOL)
    twins = {published.TWINS.get(t.method, t.method) for t in studies["table1"]}
    assert twins == set(published.TABLE_1)
    assert {t.trials for t in studies["table1"]} == {1000}
    assert {t.change for t in studies["table2"]} == set(published.TABLE_2)
    assert {t.trials for t in studies["table2"]} == {500}
    assert len(studies["furniture"]) == 100
    assert set(FURNITURE) <= set(list_supports())
    assert len([t for t in studies["table1"] if t.method == "policy"]) == 15


def test_unknown_suites_and_studies_are_named():
    with pytest.raises(ConfigError, match="paper, honest"):
        find_suite("everything", Scale())
    with pytest.raises(ConfigError, match="table1"):
        find_suite("paper", Scale(), ("table9",))


def test_methods_choose_rows_and_leave_out_studies_without_any():
    studies = find_suite("paper", Scale(methods=("policy",)))
    assert all({trial.method for trial in study.trials} == {"policy"} for study in studies)
    everything = {study.name for study in find_suite("paper", Scale())}
    assert everything - {study.name for study in find_suite("paper", Scale(methods=("normal",)))} >= {
        "furniture",
        "attempts",
    }


def test_imported_groups_are_a_study_of_their_own_where_they_are_at_hand():
    assert "imported" not in {study.name for study in find_suite("paper", Scale())}
    with pytest.raises(ConfigError, match="cluttergen import"):
        find_suite("paper", Scale(), ("imported",))
    (study,) = find_suite("paper", Scale(imported=(("paper_study", 9),)), ("imported",))
    assert {(trial.pool, trial.num_objects) for trial in study.trials} == {("paper_study", 9)}
    records = [{"trial": dataclasses.asdict(trial), "missing": "none"} for trial in study.trials]
    (table,) = tables_of(result_of(study, records))
    column = table.columns.index("paper: success")
    shown = {row[1]: row[column] for row in table.rows}
    assert shown == {"random": "0.000", "policy": "0.874"}


def test_imported_groups_stand_beside_the_papers_figures():
    assert published.table_1("policy", "paper_dining") == published.table_1("beta", "dining") == (0.912, 89)
    assert published.table_1("drop", "dining") is published.table_1("policy", "mine") is None


def result_of(study, records, measure=None):
    return {
        "format": 1,
        "suite": "paper",
        "name": study.name,
        "title": study.title,
        "layout": study.layout or study.name,
        "command": "python evaluate.py",
        "quick": True,
        "size": study.size,
        "trials": [6],
        "date": "2000-01-01",
        "machine": {
            "cores": 1,
            "cpu": "none",
            "accelerator": None,
            "python": "3",
            "versions": {"mujoco": "3"},
        },
        "records": records,
        "measure": measure,
        "pictures": ["one.png", "one.pdf"],
    }


@pytest.mark.parametrize(
    "name", ["table1", "fig1a", "steps_by_attempt", "attempts", "table2", "furniture", "density"]
)
def test_tables_hold_every_row_and_say_quick(lab, name):
    suite = "honest" if name == "density" else "paper"
    (study,) = find_suite(suite, Scale(quick=True), (name,))
    trial = dataclasses.replace(SMALL, paper_count=True, whole_attempts=True)
    figures = lab.record(trial)["figures"]
    records = [
        {"trial": dataclasses.asdict(t), "figures": figures}
        if t.method == "random" or name == "furniture"
        else {"trial": dataclasses.asdict(t), "missing": "no checkpoint", "hint": "python train.py"}
        for t in study.trials
    ]
    result = json.loads(json.dumps(result_of(study, records)))
    for table in tables_of(result):
        assert "quick: 6 trials" in table.title
        assert f"{figures['success']:.3f}" in table.markdown() or name in ("fig1a", "steps_by_attempt")
        assert table.csv().count("\n") == len(table.rows) + 1
        assert table.latex().count(r"\\") == len(table.rows) + 1
    page = document([result])
    assert "python evaluate.py" in page
    assert "](results/one.png)" in page
    assert ("python train.py" in page) == (name != "furniture")


def test_the_papers_figures_stand_beside_ours(lab):
    (study,) = find_suite("paper", Scale(), ("table2",))
    records = [{"trial": dataclasses.asdict(t), "missing": "none"} for t in study.trials]
    (table,) = tables_of(result_of(study, records))
    column = table.columns.index("paper: success")
    shown = {row[2]: row[column] for row in table.rows if row[1] == "beta"}
    assert shown == {change: f"{value:.3f}" for change, value in published.TABLE_2.items()}


def test_measured_rows_are_kept_one_by_one(tmp_path, monkeypatch):
    lab, asked, absent = Lab(Store(tmp_path / "results")), [], {"drake"}

    def stood(engine, models, poses, is_placed, seconds=(10.0,), num_threads=0):
        if engine in absent:
            raise MissingExtraError("peers", "survival")
        asked.append(engine)
        if asked == ["pybullet"] * 2:
            raise KeyboardInterrupt
        return no_movement(is_placed, seconds)

    monkeypatch.setattr(measuring, "movement_elsewhere", stood)
    trials = tuple(dataclasses.replace(SMALL, seed=seed) for seed in (0, 1))
    study = Study("survival", "elsewhere", trials, 6, measure="survival")

    def rows():
        measure = run_study(lab, study, tmp_path, "honest", "command", False)["measure"]
        return [row["engine"] for row in measure["rows"]], measure["notes"]

    with pytest.raises(KeyboardInterrupt):
        rows()
    engines, notes = rows()
    assert engines == ["pybullet"] * 2
    assert "cluttergen_jax[peers]" in notes[0]
    # The row that was interrupted was made again, the one before it was not.
    assert asked == ["pybullet"] * 3
    # An engine that has been installed meanwhile is asked, too, and it alone.
    absent.clear()
    assert rows() == (["pybullet", "drake"] * 2, [])
    assert asked[3:] == ["drake"] * 2


def test_tables_refuse_ragged_rows():
    with pytest.raises(ValueError, match="2 columns"):
        Table("t", ("a", "b"), (("1",),))


def test_results_page_agrees_with_its_json():
    results, notes = read_results(DOCS / "results"), (DOCS / "missed.md").read_text(encoding="utf-8")
    assert len(results) > 5
    assert (DOCS / "results.md").read_text(encoding="utf-8") == document(results, notes)


def test_damaged_results_are_named(tmp_path):
    (tmp_path / "table1.json").write_text("{")
    with pytest.raises(ConfigError, match=r"table1\.json"):
        read_results(tmp_path)


def test_progress_tells_time_left():
    progress = Progress(10)
    assert progress.time_left() == "time left unknown"
    progress.add(10)
    assert progress.time_left() == "0 s left"


# The command


def evaluate(tmp_path, **options):
    objects = {} if "suite" in options else {"num_objects": 2}
    return run(Evaluate(trials=4, out=str(tmp_path), **objects, **options))


def test_command_resumes_after_an_interruption(tmp_path, monkeypatch, capsys):
    whole, made = Lab.run, []

    def stopping(self, trial, judge_neighbours=True):
        if len(made) == 1:
            raise KeyboardInterrupt
        made.append(trial.support)
        return whole(self, trial, judge_neighbours)

    monkeypatch.setattr(Lab, "run", stopping)
    asked = {"methods": ("random",), "supports": ("table", "round_table")}
    assert evaluate(tmp_path, **asked) == 130
    assert "takes it up again" in capsys.readouterr().err
    made[:] = []
    monkeypatch.setattr(Lab, "run", lambda self, *a, **k: made.append(a[0].support) or whole(self, *a, **k))
    assert evaluate(tmp_path, **asked) == 0
    assert made == ["round_table"]
    rows = json.loads((tmp_path / "results.json").read_text())
    assert [row["support"] for row in rows] == list(asked["supports"])
    assert {path.suffix for path in tmp_path.iterdir() if path.is_file()} == {".md", ".csv", ".tex", ".json"}
    shown, said = capsys.readouterr()
    assert shown.startswith("| pool | support | objects | method | success [95 %] |")
    assert "2 rows, 1 kept from before, 1 to be made\n" in said
    assert "[2 of 2 rows, 1 kept from before, " in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pools": ("breakfast",)}, "dining"),
        ({"methods": ("magic",)}, "random"),
        ({"supports": ("moon",)}, "round_table"),
        ({"suite": "all"}, "honest"),
        ({"suite": "paper", "only": ("table3",)}, "table1"),
        ({"quick": True}, "--suite"),
        ({"checkpoints": "nowhere"}, "training runs"),
        ({"methods": ("policy",), "pools": ("study",), "attempts": 9}, "cluttergen train"),
        ({"suite": "paper", "only": ("table1",), "methods": ("drop",)}, "short_memory"),
        ({"supports": ()}, "one name or more"),
        ({"threads": -1}, "0 to 4096"),
        ({"seeds": 2}, "without a suite"),
        (
            {"suite": "paper", "supports": ("round_table",), "repeat": True},
            "--supports, --repeat with a suite",
        ),
    ],
)
def test_mistakes_are_explained(tmp_path, capsys, options, said):
    assert evaluate(tmp_path, **options) == 2
    assert said in capsys.readouterr().err


def test_commands_name_themselves():
    (study,) = find_suite("paper", Scale(), ("table2",))
    args = Evaluate(suite="paper", quick=True, seeds=1, pools=("my pool", "dining"))
    assert command.command_of(args, study) == (
        "cluttergen evaluate --pools 'my pool' dining --suite paper --quick --seeds 1 --only table2"
    )


def test_pool_errors_are_pool_errors(lab):
    with pytest.raises(PoolError):
        lab.check([dataclasses.replace(SMALL, pool="breakfast")])
