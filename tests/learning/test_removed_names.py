"""Methods, variants and presets of earlier versions: what is said of each; banks made by them still open."""

import json

import pytest
from cluttergen_jax.generation.sources.stored import BankSource

import cluttergen_jax as cg
from cluttergen_jax.cli.flags import removed_name
from cluttergen_jax.cli.main import main
from cluttergen_jax.config import METHODS, REMOVED, VARIANTS
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.generate import recipe_of
from cluttergen_jax.learning.methods import Method, choose_method
from cluttergen_jax.learning.training.presets import PRESETS
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.verify import scene_files, verify_scene
from tests.helpers import banks
from tests.helpers.problems import trio_problem

REMOVED_METHODS = ("ranked", "policy-clear")


def test_no_removed_name_is_in_use():
    assert not set(REMOVED) & {*METHODS, *VARIANTS, *PRESETS}


@pytest.mark.parametrize(
    "use",
    [
        *(lambda method=method: cg.generate("unused", method=method) for method in REMOVED_METHODS),
        *(lambda method=method: cg.make_sampler(method=method) for method in REMOVED_METHODS),
        lambda: cg.evaluate(methods=("ranked",)),
        lambda: cg.train(variant="ranked"),
        lambda: cg.train(preset="tight"),
    ],
)
def test_a_removed_name_is_answered_with_guided(use, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"was removed\. Allowed: .*Try: .*guided"):
        use()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("line", "given"),
    [
        ("generate --pool dining --method ranked", "method 'ranked'"),
        ("generate --method=policy-clear", "method 'policy-clear'"),
        ("evaluate --methods clear ranked", "method 'ranked'"),
        ("train --variant ranked", "variant 'ranked'"),
        ("train --preset tight", "preset 'tight'"),
    ],
)
def test_the_command_line_says_the_same(line, given, capsys):
    assert main(line.split()) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {given}, which was removed. Allowed: ")
    assert "guided" in said.split("Try: ")[1]


@pytest.mark.parametrize("line", ["generate --out tight --pool ranked", "generate --method drop tight", "x"])
def test_other_words_of_a_command_line_may_be_called_so(line):
    assert (removed_name(line.split()) is None) == ("drop" not in line)


@pytest.mark.parametrize("method", [None, "policy", "ranked"])
def test_a_stored_ranker_is_refused(method, tmp_path):
    record = {
        "format": 1,
        "variant": "ranked",
        "network": {"cost_scale": 0.005},
        "placement": {"max_attempts": 5, "history_stride": 60},
    }
    (tmp_path / "record.json").write_text(json.dumps(record))
    with pytest.raises(ConfigError, match=r"'ranked', which was removed\..*guided"):
        choose_method(method, "dining", tmp_path)


@pytest.mark.parametrize("method", REMOVED_METHODS)
def test_a_bank_by_a_removed_method_is_read_checked_and_exported(method, tmp_path, capsys, monkeypatch):
    path = tmp_path / "bank"
    recipe = recipe_of(trio_problem(), Method("drop")) | {"seed": 3, "method": method}
    monkeypatch.setattr(banks, "RECIPE", recipe | {"checkpoint": str(tmp_path / "gone")})
    banks.with_files(path)
    assert read_bank(path).table.num_rows == 3
    assert len(scene_files(path)) == 2
    assert all(verify_scene(file).stands for file in scene_files(path))
    assert main(["stats", str(path), "--card"]) == 0
    assert method in capsys.readouterr().out
    assert main(["export", str(path), "--out", str(tmp_path / "out"), "--format", "urdf"]) == 0
    assert len(cg.load_bank(path)) == 2
    source = BankSource(path)
    assert source.still(0).is_success
    assert source.methods == ()
    with pytest.raises(ConfigError, match=rf"'{method}', which was removed\..*guided"):
        source.replay(0)
