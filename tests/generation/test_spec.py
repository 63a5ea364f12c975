"""One typed request: the same fields everywhere, and none that is misspelt, for mypy and at run time."""

import dataclasses
import inspect
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.training.presets import make_settings
from cluttergen_jax.placement.clutter import Clutter
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.spec import SceneOptions, SceneSpec

ROOT = Path(__file__).parents[2]
FIELDS = {each.name: each for each in dataclasses.fields(SceneSpec)}
TAKERS = (cg.generate, cg.make_sampler, cg.make_env, cg.train, cg.evaluate)


def test_the_keywords_are_the_fields():
    assert set(SceneOptions.__annotations__) == set(FIELDS)
    own = {name: each.type for name, each in FIELDS.items()}
    # A spec holds clutter parsed as well, and a config of placing also roles.
    own["clutter"] = own["clutter"].replace(" | Clutter", "")
    own["roles"] = own["roles"].replace(" | tuple[tuple[str, str], ...]", "")
    for name, kind in SceneOptions.__annotations__.items():
        assert kind.__forward_arg__ == own[name], name


@pytest.mark.parametrize("function", TAKERS)
def test_functions_show_the_fields_and_their_defaults(function):
    shown = inspect.signature(function).parameters
    for name in FIELDS:
        assert (name in shown) != (name in function.spec_refused)
        if name in shown and name != "num_objects":
            assert shown[name].default == FIELDS[name].default
    assert "options" not in shown


@pytest.mark.parametrize("function", TAKERS)
def test_a_misspelt_field_is_refused(function):
    with pytest.raises(ConfigError, match="Did you mean 'num_objects'"):
        function(num_object=3)
    with pytest.raises(TypeError, match="num_object"):
        SceneSpec(num_object=3)


def test_a_spec_is_refused_where_a_field_of_it_counts_for_nothing():
    with pytest.raises(ConfigError, match=r"clutter = .* in an environment without a method"):
        cg.make_env(SceneSpec(clutter="stack=1"))
    with pytest.raises(ConfigError, match=r"shelf = 9 in the spec for make_env.*leaving shelf out"):
        cg.make_env(SceneSpec(shelf=9))
    with pytest.raises(ConfigError, match="tidy = True in the spec for train"):
        cg.train(SceneSpec(tidy=True))
    with pytest.raises(ConfigError, match="one pool"):
        cg.make_sampler("dining", pool="office")
    with pytest.raises(ConfigError, match="a SceneSpec, or a pool's name"):
        cg.make_sampler(3)


def test_training_takes_objects_a_region_and_rules(monkeypatch):
    seen = []
    place = "cluttergen_jax.learning.training.train.run_training"
    monkeypatch.setattr(place, lambda config, show: seen.append(config))
    cg.train(
        SceneSpec(
            objects=("mug", "bowl"),
            num_objects=2,
            region="0.3x0.3",
            min_margin=0.005,
            stability="shift=0.001",
        )
    )
    settings = seen[0].settings()
    usual = make_settings("cpu", "policy")
    assert seen[0].problem.objects == ("mug", "bowl")
    assert seen[0].problem.region.half_extents == (0.15, 0.15)
    rules = dataclasses.replace(usual.placement, num_objects=2, min_margin=0.005)
    limits = dataclasses.replace(usual.stability, max_shift=0.001, stand_full_shift=0.001)
    assert (settings.placement, settings.stability) == (rules, limits)
    with pytest.raises(ConfigError, match=r"region = '0.3x0.3' with variant 'guided'"):
        cg.train(region="0.3x0.3", variant="guided")


def test_an_environment_takes_what_its_method_brings_about():
    env = cg.make_env(num_objects=2, method="spread", tidy=True, relations=("mug on dinner_plate",))
    config = env.unwrapped.rules.config
    assert config.tidy
    assert config.relations == ("mug on dinner_plate",)
    with pytest.raises(ConfigError, match="`tidy` with method 'drop'"):
        cg.make_env(method="drop", tidy=True)


def test_equal_requests_are_equal():
    spec = SceneSpec(objects=["mug", "bowl"], pool=Path("dining"), clutter={"stack": 1.0})
    assert spec == SceneSpec(objects=("mug", "bowl"), clutter="stack=1")
    assert hash(spec) == hash(dataclasses.replace(spec))
    assert spec.clutter == Clutter(stack=1.0)
    assert eval(repr(spec)) == spec
    assert repr(SceneSpec()) == "SceneSpec()"


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"num_objects": 0}, "num_objects = 0.*1 to 128"),
        ({"num_objects": 2.5}, "a whole number"),
        ({"max_attempts": 11}, "1 to 10"),
        ({"budget": 3, "num_objects": 4}, "4 to 10000 attempts"),
        ({"min_margin": -1.0}, "0 to 0.1 m"),
        ({"ruin_after": 6}, "0 to 5"),
        ({"engine": "fast"}, "auto, native, warp, jax"),
        ({"method": "guide"}, "Did you mean 'guided'"),
        ({"for_engine": "pybulet"}, "Did you mean 'pybullet'.*drake, pybullet, isaac"),
        ({"containment": "all"}, "center, footprint"),
        ({"tidy": True, "natural": True}, "one or the other"),
        ({"region": 3}, "a Rectangle"),
        ({"keep_out": Rectangle()}, "a sequence"),
        ({"num_threads": -1}, "0 to"),
    ],
)
def test_a_value_is_checked_when_it_is_given(asked, said):
    with pytest.raises(ConfigError, match=said):
        SceneSpec(**asked)


@pytest.mark.slow
def test_a_bank_gives_its_request_back(tmp_path):
    spec = SceneSpec(
        num_objects=2,
        support="table-0.40x0.50",
        region="0.3x0.3",
        keep_out=("0.1,0,0.05,0.05",),
        method="spread",
        clutter="stack=1",
        overhang="none",
        robust=True,
    )
    cg.generate(tmp_path / "one", spec, num_scenes=2, max_files=0)
    bank = read_bank(tmp_path / "one")
    cg.generate(tmp_path / "two", bank.spec, num_scenes=2, max_files=0)
    again = read_bank(tmp_path / "two")
    assert again.spec == bank.spec == dataclasses.replace(bank.spec, order="weighted", ruin_after=5)
    assert again.table.equals(bank.table)


def complaints(folder, *arguments):
    """What mypy says."""
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--config-file",
        str(ROOT / "pyproject.toml"),
        *arguments,
    ]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stdout


def test_a_seat_and_a_table_of_sense_that_nothing_reads_are_refused():
    with pytest.raises(ConfigError, match=r"seat = '\+x' of scenes that are not natural"):
        SceneSpec(seat="+x").problem_config("spread")
    SceneSpec(seat="+x", natural=True).problem_config("spread")
    with pytest.raises(ConfigError, match=r"'mine\.yaml', which nothing here reads"):
        SceneSpec(sense="mine.yaml").check_sense()
    for reader in ({"natural": True}, {"theme": "desk"}, {"poses": "usual"}):
        SceneSpec(sense="mine.yaml", **reader).check_sense()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_mypy_refuses_a_field_that_is_misspelt_or_renamed(tmp_path):
    shutil.copytree(
        ROOT / "cluttergen_jax", tmp_path / "cluttergen_jax", ignore=lambda *_: ["__pycache__"]
    )
    (tmp_path / "cluttergen_jax" / "misspelt.py").write_text(
        "import cluttergen_jax as cg\n"
        "cg.SceneSpec(num_object=3)\n"
        "cg.generate(num_object=3)\n"
        "cg.evaluate(num_object=3)\n"
        "cg.train(num_object=3)\n"
    )
    said = complaints(tmp_path, "cluttergen_jax")
    for line in range(2, 6):
        assert f"misspelt.py:{line}: error: Unexpected keyword argument" in said
    assert "Found 4 errors" in said
    (tmp_path / "cluttergen_jax" / "misspelt.py").unlink()
    spec = tmp_path / "cluttergen_jax" / "spec.py"
    text = spec.read_text()
    renamed = text.replace("    for_engine: OtherEngine | None = None", "    of_engine: str = ''")
    assert renamed != text
    spec.write_text(renamed)
    assert '"SceneSpec" has no attribute "for_engine"' in complaints(tmp_path, "cluttergen_jax")


@pytest.mark.parametrize(
    ("asked", "is_crowded", "budget"),
    [
        ({"num_objects": 10}, False, None),
        ({"pool": "all", "num_objects": 30}, False, 206),
        ({"pool": "all", "num_objects": 50}, True, 1000),
        ({"pool": "all", "num_objects": 50, "budget": 300}, True, 300),
        ({"pool": "all", "num_objects": 50, "ruin_after": 0}, False, None),
        ({"pool": "all", "num_objects": 50, "setting": "paper"}, False, None),
    ],
)
def test_crowded_scenes_have_more_attempts(asked, is_crowded, budget):
    placement = SceneSpec(**asked).problem_config("guided").placement
    assert (placement.is_crowded, placement.budget) == (is_crowded, budget)
