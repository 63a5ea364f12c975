"""One function for each command: the same options, the same defaults, the same errors in their own words."""

import ast
import inspect
import json
import re
from operator import attrgetter
from pathlib import Path
from types import ModuleType

import pytest

import cluttergen_jax
from cluttergen_jax.cli.flags import with_flags
from cluttergen_jax.cli.main import COMMANDS, load, main
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.learning.policies.embedded import list_policies
from tests.helpers.banks import two_scenes
from tests.helpers.error_calls import error_calls
from tests.helpers.options import options_in

ROOT = Path(__file__).parents[2]
FUNCTIONS = (
    "generate",
    "verify",
    "export",
    "view",
    "place_by_hand",
    "render",
    "train",
    "train_suite",
    "pretrain",
    "import_pool",
    "import_support",
    "push_bank",
    "pull_bank",
    "evaluate",
    "certify",
    "placer_data",
    "placer_eval",
    "placer_train",
    "robot_grasps",
    "robot_place",
    "grasp_dataset",
    "rearrange",
    "judge",
    "repair",
    "check_layout",
    "ask_layout",
)
# Options and defaults as `--help` told them before commands were made from functions.
OPTIONS = json.loads((Path(__file__).parent / "options.json").read_text())


def options_told(name, capsys, monkeypatch):
    """The flags of each option in the help of a command, and what is told of its default."""
    monkeypatch.setenv("COLUMNS", "300")
    assert main([*name.split(), "--help"]) == 0
    return options_in(capsys.readouterr().out)


@pytest.mark.parametrize("name", OPTIONS)
def test_a_command_has_the_options_and_defaults_that_it_has_had(name, capsys, monkeypatch):
    assert options_told(name, capsys, monkeypatch) == OPTIONS[name]


def test_the_options_are_those_of_a_whole_command_line():
    assert {name.split()[0] for name in OPTIONS} == set(COMMANDS)
    assert sum(map(len, OPTIONS.values())) > 150
    assert OPTIONS["generate"]["--num-scenes, -n"] == "default: 20"


@pytest.mark.parametrize("name", cluttergen_jax.__all__)
def test_every_name_is_there_and_says_what_it_is(name):
    found = getattr(cluttergen_jax, name)
    assert found.__doc__
    if isinstance(found, ModuleType):
        assert dir(found) == sorted(found.__all__)
        assert all(getattr(found, each).__doc__ for each in found.__all__)


def test_few_names_are_shown_and_all_of_them_are_public():
    assert dir(cluttergen_jax) == sorted(cluttergen_jax.__all__)
    assert len(dir(cluttergen_jax)) <= 45


@pytest.mark.parametrize(
    ("former", "name"),
    [
        ("placer_data", "placer.data"),
        ("make_robot_env", "robot.make_env"),
        ("ask_layout", "layout.ask"),
        ("push_bank", "hub.push_bank"),
        ("stats_of", "stats"),
        ("SceneBatch", "typing.SceneBatch"),
    ],
)
def test_a_former_name_is_not_shown_and_is_the_same(former, name):
    assert former not in dir(cluttergen_jax)
    assert getattr(cluttergen_jax, former) is attrgetter(name)(cluttergen_jax)


def test_stats_of_a_folder_are_those_of_its_bank_and_print_as_the_command_does(tmp_path, capsys):
    two_scenes(tmp_path)
    stats = cluttergen_jax.stats(tmp_path)
    bank = cluttergen_jax.read_bank(tmp_path)
    assert stats == cluttergen_jax.stats(bank)
    assert main(["stats", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{stats}\n" == f"{cluttergen_jax.stats_text(bank, stats)}\n"
    assert main(["stats", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out).keys() == stats.as_json().keys()


def test_a_name_that_is_none_is_told_what_was_meant():
    with pytest.raises(
        AttributeError, match=r"no attribute 'load_pols'. Did you mean 'load_pool'\?"
    ):
        cluttergen_jax.load_pols  # noqa: B018
    with pytest.raises(AttributeError, match=r"'cluttergen_jax.robot' .*Did you mean 'grasps'\?"):
        cluttergen_jax.robot.grasp  # noqa: B018


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_argument_is_explained(name):
    function = getattr(cluttergen_jax, name)
    doc = inspect.getdoc(function)
    others = "that are not explained here are those of" in " ".join(doc.split())
    for argument in inspect.signature(function).parameters:
        assert others or re.search(rf"\b{argument}\b", doc.split("Args:")[-1]), argument
    assert "Raises:" in doc


# Commands parse, call and print


# One error, two doors


def test_python_and_the_command_line_name_what_each_of_them_knows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    policy = str(next(iter(list_policies().values())))
    doors = [
        (
            lambda: cluttergen_jax.generate(num_threads=-1),
            "num_threads = -1",
            ["generate", "--num-threads", "-1"],
        ),
        (lambda: cluttergen_jax.generate(num_scenes=0), "num_scenes = 0", ["generate", "-n", "0"]),
        (
            lambda: cluttergen_jax.verify("x.xml", jobs=-1),
            "jobs = -1",
            ["verify", "x.xml", "--jobs", "-1"],
        ),
        (
            lambda: cluttergen_jax.train(memory_limit=-1.0),
            "memory_limit = -1.0",
            ["train", "--memory-limit", "-1"],
        ),
        (
            lambda: cluttergen_jax.generate(method="drop", checkpoint=policy),
            "`checkpoint` with method 'drop'",
            ["generate", "--method", "drop", "--checkpoint", policy],
        ),
    ]
    flags = [
        "--num-threads -1",
        "--num-scenes 0",
        "--jobs -1",
        "--memory-limit -1.0",
        "--checkpoint with method",
    ]
    for (call, said, words), flag in zip(doors, flags, strict=True):
        with pytest.raises(ConfigError, match=re.escape(said)) as raised:
            call()
        assert "--" not in str(raised.value)
        assert main(words) == 2
        assert flag in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_flags_stand_for_arguments_and_not_for_what_is_quoted_of_a_file():
    said = 'cup.urdf: <mesh scale="0.1 0.1">, not 1 < 2; `scale` or scale = -1'
    assert (
        with_flags(said, load("import"))
        == 'cup.urdf: <mesh scale="0.1 0.1">, not 1 < 2; --scale or --scale -1'
    )


def test_the_library_speaks_of_no_flags():
    """But for whole commands, which say `cluttergen` or `pip install` first."""
    package = ROOT / "cluttergen_jax"
    skipped = {package / "cli", package / "scene" / "export" / "scripts"}
    for path in package.rglob("*.py"):
        if skipped & set(path.parents):
            continue
        for node in error_calls(ast.parse(path.read_text())):
            for text in map(ast.unparse, [*node.args, *(each.value for each in node.keywords)]):
                if flag := re.search(r"(?<![\w-])--[a-z]", text):
                    before = text[: flag.start()]
                    assert "cluttergen " in before or "pip install " in before, (
                        f"{path.name}: {text}"
                    )
