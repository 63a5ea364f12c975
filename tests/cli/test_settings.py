"""Settings that cannot be meant, and places that cannot be written to: refused with a sentence, at once."""

import math
from dataclasses import replace

import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.support import Rectangle, cuboid_table
from cluttergen_jax.assets.support_map import check_region
from cluttergen_jax.cli.main import main
from cluttergen_jax.config import ContactConfig, StabilityConfig, VerifyConfig
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.importing.readers import ReadOptions
from cluttergen_jax.importing.run import ObjectConfig
from tests.helpers.banks import two_scenes

NOT_POSITIVE = (math.nan, math.inf, 0.0, -1.0, True)


@pytest.mark.parametrize("value", NOT_POSITIVE)
@pytest.mark.parametrize(
    ("config", "name"),
    [
        (VerifyConfig(), "seconds"),
        (VerifyConfig(), "max_shift"),
        (VerifyConfig(), "max_turn_deg"),
        (ReadOptions(), "scale"),
        (ReadOptions(), "density"),
        (ReadOptions(), "mass"),
        (ObjectConfig(), "trials"),
        (ContactConfig(), "gravity"),
        (ContactConfig(), "iterations"),
        (StabilityConfig(), "timestep"),
    ],
)
def test_numbers_have_to_be_finite_and_above_zero(config, name, value):
    with pytest.raises(ConfigError, match=name):
        replace(config, **{name: value})
    assert getattr(replace(config, **{name: 2}), name) == 2


# Regions


@pytest.mark.parametrize("turn", [0.0, 0.5])
@pytest.mark.parametrize(
    ("region", "fits"),
    [
        (Rectangle((0.0, 0.0), (0.305, 0.355)), True),
        (Rectangle((0.1, 0.0), (0.2, 0.35)), True),
        (Rectangle((0.0, 0.0), (0.34, 0.29), math.pi / 2), True),
        (Rectangle((0.0, 0.0), (0.6, 0.6)), False),
        (Rectangle((0.12, 0.0), (0.2, 0.35)), False),
        (Rectangle((0.0, 0.0), (0.3, 0.35), math.pi / 2), False),
        (Rectangle((0.0, 0.0), (0.25, 0.25), math.pi / 4), False),
    ],
)
def test_regions_lie_on_the_top_however_they_and_it_are_turned(region, fits, turn):
    own = cuboid_table()
    x, y = region.center
    center = (x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn))
    region = replace(region, center=center, yaw=region.yaw + turn)
    table = replace(
        own, boxes=(replace(own.boxes[0], yaw=turn),), region=replace(own.region, yaw=turn)
    )
    if fits:
        check_region(region, table)
        return
    with pytest.raises(ConfigError, match="beyond support"):
        check_region(region, table)


def test_regions_that_grow_in_evaluation_may_be_wider_than_the_top(tmp_path):
    runner = Runner(Store(tmp_path))
    problem = runner.setup(runner.resolve(Trial.of(change="all", num_objects=1)))
    assert problem.region.half_extents == (0.30, 0.35)
    np.testing.assert_allclose(problem.rules.region.half_extents, (0.35, 0.35))


# Scenes in a user's own model


# The command line


@pytest.mark.parametrize(
    "words",
    [
        ["pretrain", "--encoder", "set"],
        ["evaluate", "--methods", "random", "--trials", "1"],
        ["train", "--num-objects", "2"],
        ["export", "bank", "--format", "mjcf"],
        ["robot", "place", "bank"],
        ["rearrange"],
        ["render", "bank"],
        ["placer", "data", "bank"],
    ],
)
def test_a_file_in_the_place_of_the_folder_is_explained(words, tmp_path, monkeypatch, capsys):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    two_scenes(tmp_path / "bank")
    monkeypatch.chdir(tmp_path)
    assert main([*words, "--out", str(taken)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert str(taken) in said
    assert "Try: " in said
    assert taken.read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["inspect", "dining", "--out", ""], "Allowed: a file on this machine"),
        (["inspect", "dining", "--out", "."], "Try: --out dining.png"),
        (["robot", "grasps", "dining", "--out", ""], "Allowed: a file on this machine"),
        (
            ["robot", "place", "--out", "s3://bucket/name"],
            "--out s3://bucket/name. Allowed: a folder on this",
        ),
        (["placer", "data", "--out", "s3://bucket/name"], "Allowed: a folder on this machine"),
        (["render", "bank", "--sheet", "--columns", "0"], "--columns 0. Allowed: 1 to 1000"),
        (["render", "bank", "--bop", "--views", "99999"], "--views 99999. Allowed: 1 to 10000"),
        (["render", "bank", "--samples", "100000"], "1 to 4096 samples"),
        (
            ["render", "bank", "--no-picture"],
            "--no-picture, and nothing else is asked for. Allowed: one or",
        ),
        (["robot", "place", "--task", "lift", "--noise", "1"], "Try: --task place"),
        (["view", "bank", "--place"], "source 'bank' with --place"),
        (["evaluate", "--suite", "paper", "--quick"], "Try: `python evaluate.py --suite ...`"),
        (["evaluate", "--workers", "2"], "--workers 2 without --cluster. Allowed:"),
        (["pull", "me/bank", "--hub", "ftp://x"], "no hub at ftp://x"),
        (["pull", "me/bank", "--hub", "taken"], "Try: another --hub"),
        (
            ["view", "bank", "--host", "no.such.host.invalid"],
            "--host no.such.host.invalid cannot be",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused_in_the_words_of_the_command(
    words, said, tmp_path, monkeypatch, capsys
):
    (tmp_path / "taken").write_text("mine")
    two_scenes(tmp_path / "bank")
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert said in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["bank", "taken"]


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda: cg.generate(num_threads="2"), "num_threads = '2'"),
        (lambda: cg.generate(num_threads=1.5), "num_threads = 1.5"),
        (lambda: cg.generate(keep_out="0,0,0.1,0.1"), "keep_out = '0,0,0.1,0.1'"),
        (lambda: cg.robot_grasps("dining", "mug"), "objects = 'mug'"),
        (lambda: cg.robot_place(placer="scored", noise="x"), "noise = 'x'"),
        (lambda: cg.export("bank", "out", scenes=[1.5]), r"scenes = \[1.5\]"),
        (lambda: cg.render("bank", scenes=3), "scenes = 3"),
        (lambda: cg.certify("bank", seconds="x"), "seconds = 'x'"),
        (lambda: cg.evaluate(pools="dining"), "pools = 'dining'"),
    ],
)
def test_python_is_told_what_it_gave(ask, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        ask()
    assert not list(tmp_path.iterdir())
