"""What can be made can be measured: rows take every field of a request, and make what `generate` makes."""

import dataclasses

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.api import _specs_of_rows
from cluttergen_jax.evaluation.resolved import Checkpoints, Resolver
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial, key_of, trial_of
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.spec import SceneSpec

# A method and fields that earlier versions refused; and what rows, or the table's title, call them.
ASKED = {
    "objects": ("drop", {"objects": ("mug*", "*plate", "bowl*")}, "objects mug*, *plate, bowl*"),
    "shelf": ("drop", {"shelf": 4}, "shelf 4"),
    "weights": ("drop", {"shelf": 4, "weights": "mug*=3"}, "weights mug*=3"),
    "balance": ("drop", {"shelf": 4, "balance": "label"}, "balance label"),
    "surface": ("drop", {"support": "bookcase", "surface": "all"}, "surface all"),
    "region": ("drop", {"region": "0.3x0.4"}, "region 0.3x0.4"),
    "keep_out": ("drop", {"keep_out": ("0,0,0.1,0.1",)}, "keep out 0,0,0.1,0.1"),
    "containment": ("drop", {"containment": "footprint"}, "containment footprint"),
    "robust": ("drop", {"robust": True}, "robust"),
    "for_engine": ("drop", {"for_engine": "drake"}, "for drake"),
    "overhang": ("drop", {"overhang": "half"}, "overhang half"),
    "clutter": ("spread", {"clutter": "stack=1"}, "stack=1"),
    "natural": ("spread", {"natural": True}, "natural"),
    "tidy": ("spread", {"tidy": True}, "tidy"),
    "relations": ("spread", {"relations": ("mug left_of bowl",)}, "relations mug left_of bowl"),
    "roles": ("spread", {"relations": ("a left_of bowl",), "roles": "a=mug*"}, "roles a=mug*"),
    "arrangements": (
        "spread",
        {"arrangements": ("stack bowl:2",), "repeat": True},
        "arrangements stack bowl:2",
    ),
    "clearance": ("packed", {"clearance": 0.01}, "clearance 0.01"),
}
SMALL = SceneSpec(num_objects=2)


def trial_with(method, fields, **own):
    spec = dataclasses.replace(SMALL, method=method, **fields)
    return Trial(spec, trials=3, **own)


def test_no_field_is_refused_but_sets_and_those_that_rows_differ_in():
    assert set(cg.evaluate.spec_refused) == {"pool", "support", "method", "sets"}
    with pytest.raises(ConfigError, match=r"evaluate\(pool='dining'\), each row has its own"):
        cg.evaluate(pool="dining")


@pytest.fixture(scope="module")
def resolver():
    return Resolver(Checkpoints(), "auto")


@pytest.mark.parametrize("name", ASKED)
def test_a_row_asks_what_generate_asks(name, resolver):
    method, fields, told = ASKED[name]
    trial = trial_with(method, fields)
    resolved = resolver.resolve(trial)
    spec = dataclasses.replace(SMALL, method=method, **fields)
    assert resolved.config == spec.problem_config(method)
    assert told in (*trial.asked, *trial.row_name.split(", "), trial.row_name.partition(", ")[2])
    # It is told from the row that asks nothing of the kind, and read again as it was stored.
    plain = trial_with(method, {})
    assert key_of(trial, {}) != key_of(plain, {})
    assert trial_of({"trial": trial.fields()}) == trial


def test_rectangles_are_stored_as_they_were_given():
    box = Rectangle((0.1, 0.0), (0.1, 0.2), 0.3)
    for fields in ({"region": box}, {"keep_out": (box, "0,0,0.1,0.1")}, {"region": "outline"}):
        trial = trial_with("drop", fields)
        assert trial_of({"trial": trial.fields()}) == trial


def test_rows_are_of_methods_that_can_make_what_is_asked():
    natural = dataclasses.replace(SMALL, natural=True)
    methods = [spec.method for spec in _specs_of_rows(natural, (), ("dining",), ("table",))]
    assert set(methods) == {"spread", "guided"}
    with pytest.raises(ConfigError, match="`natural` with method 'drop'"):
        _specs_of_rows(natural, ("drop", "spread"), ("dining",), ("table",))
    packed = dataclasses.replace(SMALL, clearance=0.01)
    with pytest.raises(ConfigError, match=r"clearance = 0\.01"):
        _specs_of_rows(packed, (), ("dining",), ("table",))


@pytest.fixture(scope="module")
def runner():
    return Runner(Store(None), num_threads=1)


def same_as_generated(runner, folder, spec, number=4):
    """A row's scenes against those of a bank of the same request and seed."""
    cg.generate(folder, spec, num_scenes=number, seed=3, max_files=0)
    rows = [read_bank(folder).rows(range(number))[index] for index in range(number)]
    trial = Trial(spec, trials=number, seed=3)
    outcome = runner.run(runner.resolve(trial))
    assert [row.is_success for row in rows] == outcome.scenes.is_success.tolist()
    for index, row in enumerate(rows):
        poses = outcome.scenes.poses[index][outcome.scenes.is_placed[index]]
        np.testing.assert_allclose(row.poses, poses, atol=1e-6)
    return outcome


@pytest.mark.slow
def test_scenes_of_a_row_are_those_of_generate(runner, tmp_path):
    spec = dataclasses.replace(
        SMALL,
        method="drop",
        objects=("mug*", "*plate", "bowl*"),
        support="table-0.40x0.50",
        region="0.3x0.3",
        keep_out=("0.1,0,0.05,0.05",),
        containment="footprint",
        overhang="none",
    )
    same_as_generated(runner, tmp_path / "bank", spec)


@pytest.mark.slow
def test_rows_of_shelves_are_those_of_generate(runner, tmp_path):
    spec = dataclasses.replace(SMALL, method="drop", shelf=3, weights="mug*=3", balance="label")
    outcome = same_as_generated(runner, tmp_path / "bank", spec)
    # Numbers are about the pool, of which a shelf holds three objects.
    assert outcome.scenes.object_index.max() >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ASKED))
def test_every_field_is_measured_as_it_is_made(name, runner, tmp_path):
    method, fields, _ = ASKED[name]
    spec = dataclasses.replace(SMALL, method=method, **fields)
    same_as_generated(runner, tmp_path / "bank", spec, 2)


@pytest.mark.slow
def test_a_row_begins_with_a_scene_of_a_bank(runner, tmp_path):
    cg.generate(tmp_path / "first", SMALL, num_scenes=2, seed=1, max_files=0, method="drop")
    start = f"{tmp_path / 'first'}:0"
    spec = dataclasses.replace(SMALL, method="drop", start=start)
    same_as_generated(runner, tmp_path / "second", spec)


@pytest.mark.slow
def test_the_table_tells_what_was_asked_of_all_rows(tmp_path):
    found = cg.evaluate(
        ("drop",), num_objects=2, trials=2, objects=("mug*", "bowl*"), overhang="half", out=tmp_path
    )
    assert "objects mug*, bowl*" in found.table.title
    assert found.rows[0]["asked"] == "objects mug*, bowl*"
    assert found.rows[0]["row"] == "drop, overhang half"
