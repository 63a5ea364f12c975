"""Banks, samplers and tables by a user's own method, and by other limits of what is stable."""

import json
import pickle
from dataclasses import replace

import jax
import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.config import StabilityConfig, VerifyConfig, stability_of, stability_text
from cluttergen_jax.errors import BankError, ClutterGenError, ConfigError
from cluttergen_jax.generation.sources.scene_sources import BankSource
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.card import card_text
from cluttergen_jax.scene.bank.stats import stats_of
from cluttergen_jax.spec import SceneSpec
from tests.helpers import own_methods
from tests.helpers.own_methods import at_rest

FILE = own_methods.__file__


@pytest.fixture(scope="module")
def bank(pool, tmp_path_factory):
    folder = tmp_path_factory.mktemp("own") / "bank"
    asked = SceneSpec(pool=pool, num_objects=2, method=at_rest, stability="shift=1mm,turn=1deg")
    return cg.generate(folder, asked, num_scenes=2, render=False)


def test_the_recipe_and_the_card_tell_method_and_limits(bank):
    method = bank.spec.method
    assert (method.name, method.digest) == (bank.recipe["method"], bank.recipe["method_digest"])
    assert method.part is None
    assert bank.recipe["method"] == "at_rest"
    assert bank.recipe["stability"]["stand_full_shift"] == 0.001
    assert bank.spec.stability == "shift=0.001,turn=1deg"
    text = card_text(bank, stats_of(bank))
    assert f"- method: at_rest, a user's own, digest {method.digest}\n" in text
    assert "in place of the usual limits: shift=0.001,turn=1deg." in text


def test_the_same_call_goes_on_and_another_digest_is_refused(bank):
    asked = replace(bank.spec, method=f"{FILE}:at_rest")
    assert cg.generate(bank.path, asked, num_scenes=2, render=False).num_scenes == 2
    at_rest.digest = "another"
    try:
        with pytest.raises(BankError, match="method_digest"):
            cg.generate(bank.path, replace(asked, method=at_rest), num_scenes=3, render=False)
    finally:
        del at_rest.digest
    with pytest.raises(BankError, match="stability"):
        cg.generate(bank.path, replace(asked, stability=None), num_scenes=3, render=False)


def test_a_bank_is_used_without_its_method_which_is_named_where_it_lacks(bank):
    report = cg.verify(bank.path)
    assert report.config == VerifyConfig(max_shift=0.001, max_turn_deg=1.0)
    assert "no object moved more than 1 mm or 1 deg" in str(report)
    assert "the bank's own recipe (`stability`)" in str(report)
    assert cg.verify(bank.path, VerifyConfig(max_shift=0.01)).config.max_shift == 0.01
    source = BankSource(bank.path)
    assert source.still(0).title.endswith("scene 0")
    with pytest.raises(ClutterGenError, match=r"'at_rest' .*not at hand.*`method`"):
        source.replay(0)


def test_a_sampler_of_it_is_pickled(bank, pool):
    sample = cg.make_sampler(
        pool=pool, num_objects=2, method=at_rest, stability=bank.spec.stability
    )
    again = pickle.loads(pickle.dumps(sample))
    assert repr(again) == repr(sample)
    assert "at_rest" in repr(sample)
    seen = jax.jit(again)(jax.random.fold_in(jax.random.key(0), 0))
    assert bool(seen.is_success) == read_bank(bank.path).rows([0])[0].is_success


@pytest.mark.slow
def test_several_of_them_stand_in_one_table(pool, tmp_path):
    methods = (at_rest, f"{FILE}:near_middle", "random")
    found = cg.evaluate(methods, (pool,), num_objects=2, trials=4, out=tmp_path / "rows")
    assert [row["method"] for row in found.rows] == ["at_rest", "near_middle", "random"]
    assert found.num_missing == 0
    kept = json.loads((tmp_path / "rows" / "results.json").read_text())
    assert [row["row"] for row in kept] == ["at_rest", "near_middle", "random"]


def test_the_command_line_takes_a_file_and_a_name(pool, tmp_path, capsys):
    words = ["generate", "--pool", pool, "--num-objects", "2", "-n", "1", "--no-render"]
    out = tmp_path / "bank"
    assert main([*words, "--method", f"{FILE}:at_rest", "--out", str(out)]) == 0
    assert read_bank(out).recipe["method"] == "at_rest"
    assert main([*words, "--method", f"{FILE}:at_rst", "--out", str(out)]) == 2
    assert "Did you mean 'at_rest'" in capsys.readouterr().err


# Limits


def test_limits_are_read_from_text_mappings_and_configs():
    usual = StabilityConfig()
    strict = replace(usual, max_shift=0.001, stand_full_shift=0.001)
    for given in ("shift=1mm", " shift = 0.001 ", {"shift": 0.001}, {"shift": "1 mm"}, strict):
        assert stability_of(given) == strict
        assert SceneSpec(stability=given) == SceneSpec(stability="shift=0.001")
    assert SceneSpec(stability=usual) == SceneSpec()
    loose = stability_of("shift=0.00001,quiet_steps=30,per_axis=1,max_speed=0.01")
    assert loose.stand_shift == 0.00001
    assert (loose.quiet_steps, loose.per_axis) == (30, True)
    assert stability_of(stability_text(loose)) == loose
    assert stability_text(usual) == ""


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ("shift", "NAME=VALUE"),
        ("shft=1", "Did you mean 'shift'"),
        ("shift=wide", "shift='wide'"),
        ("shift=nan", "a number"),
        ("shift=-1mm", "above zero"),
        ("shift=1,shift=2", "shift comes twice"),
        ("timestep=0.1", "another timestep"),
        ("robust_tilt=0.1", "robust=True"),
        (StabilityConfig(both_detectors=True), "another both_detectors"),
        ("quiet_steps=1.5", "a whole number"),
        ("settle_steps=400", "at most max_steps"),
        ("", "text, a mapping"),
        (3, "stability = 3"),
    ],
)
def test_limits_that_cannot_be_meant_are_refused(given, match):
    with pytest.raises(ConfigError, match=match):
        SceneSpec(stability=given)
