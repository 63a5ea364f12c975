"""One function for each command: the same options, the same defaults, the same errors in their own words."""

import ast
import dataclasses
import inspect
import re
from pathlib import Path

import pytest

import cluttergen_jax
from cluttergen_jax.cli.commands import COMMANDS
from cluttergen_jax.cli.flags import ARGUMENTS, with_flags
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.learning.policies.embedded import list_policies

ROOT = Path(__file__).parents[2]
# The functions of a command, options that its function calls otherwise, and those that it has no use for.
PAIRS = {
    "generate": (["generate"], {}, set()),
    "verify": (["verify"], {}, set()),
    "export": (["export"], {}, set()),
    "view": (["view"], {}, set()),
    "render": (["render"], {}, set()),
    "train": (["train", "train_suite"], {}, set()),
    "pretrain": (["pretrain"], {}, set()),
    # The file of a table is an option of the command and the first argument of the function.
    "import": (["import_pool", "import_support"], {"support": "path"}, set()),
    "push": (["push_bank"], {"bank": "path"}, set()),
    # A bank is pulled into the working folder by the command, into the cache of banks by the function.
    "pull": (["pull_bank"], {}, set()),
    "evaluate": (["evaluate", "evaluate_suite"], {}, set()),
    "certify": (["certify"], {"path": "bank"}, set()),
    # `stats_text` and `BankStats.as_json` are what it chooses from.
    "stats": (["read_bank"], {}, {"card", "json"}),
}
# What takes lines of progress.
OF_PROGRESS = {"show"}
# Other work adds these, or they are a few lines of printing around `load_pool` and `list_pools`.
WITHOUT = {"pool", "inspect", "list", "doctor"}


def defaults_of(function):
    return {
        name: each.default
        for name, each in inspect.signature(function).parameters.items()
        if name not in OF_PROGRESS
    }


def test_every_command_has_its_function():
    assert set(PAIRS) | WITHOUT == set(COMMANDS)


@pytest.mark.parametrize("name", PAIRS)
def test_a_command_and_its_function_have_equal_options_and_defaults(name):
    functions, renamed, alone = PAIRS[name]
    command = COMMANDS[name].load()
    options = {}
    for field in dataclasses.fields(command):
        if field.name not in alone:
            argument = renamed.get(field.name, ARGUMENTS.get(field.name, field.name))
            made = field.default_factory is not dataclasses.MISSING
            # A config of its defaults is what None stands for.
            options[argument] = None if made else field.default
    known = {}
    for each in functions:
        given = defaults_of(getattr(cluttergen_jax, each))
        for argument, default in given.items():
            needed = inspect.Parameter.empty
            assert options[argument] == default or needed is default, (each, argument)
            if default is needed:
                # What a function cannot do without has no default in the command, or none that counts.
                assert options[argument] in (dataclasses.MISSING, None, ()), argument
        known |= given
    assert set(known) == set(options)


@pytest.mark.parametrize("name", cluttergen_jax.__all__)
def test_every_name_is_there_and_says_what_it_is(name):
    assert getattr(cluttergen_jax, name).__doc__
    assert name in dir(cluttergen_jax)


@pytest.mark.parametrize(
    "name", [each for functions, *_ in PAIRS.values() for each in functions if each != "read_bank"]
)
def test_every_argument_is_explained(name):
    function = getattr(cluttergen_jax, name)
    doc = inspect.getdoc(function)
    others = "The others are" in doc
    for argument in inspect.signature(function).parameters:
        assert others or re.search(rf"\b{argument}\b", doc.split("Args:")[-1]), argument
    assert "Raises:" in doc


# Commands parse, call and print


def code_lines(path):
    """Lines of code but for options, docstrings and imports."""
    lines = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) else node.body
            lines |= {node.lineno} | {
                line for each in body for line in range(each.lineno, each.end_lineno + 1)
            }
    return len(lines)


@pytest.mark.parametrize("name", sorted(set(COMMANDS)))
def test_commands_are_short(name):
    assert code_lines(ROOT / "cluttergen_jax" / "cli" / f"{COMMANDS[name].module}.py") <= 60


@pytest.mark.parametrize("folder", ["examples", "benchmarks", "docs"])
def test_nothing_but_programs_imports_the_command_line(folder):
    # The site prints what the commands say of themselves.
    files = {path.name: path for path in (ROOT / folder).rglob("*.py")} | {"site_pages.py": None}
    for name, path in files.items():
        assert path is None or "cluttergen_jax.cli" not in path.read_text(), name


# One error, two doors


def test_python_and_the_command_line_name_what_each_of_them_knows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    policy = str(next(iter(list_policies().values())))
    doors = [
        (
            lambda: cluttergen_jax.generate(num_threads=-1),
            "num_threads = -1",
            ["generate", "--threads", "-1"],
        ),
        (lambda: cluttergen_jax.generate(num_scenes=0), "num_scenes = 0", ["generate", "-n", "0"]),
        (lambda: cluttergen_jax.verify("x.xml", jobs=-1), "jobs = -1", ["verify", "x.xml", "--jobs", "-1"]),
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
    flags = ["--threads -1", "--num-scenes 0", "--jobs -1", "--memory-limit -1.0", "--checkpoint with method"]
    for (call, said, words), flag in zip(doors, flags, strict=True):
        with pytest.raises(ConfigError, match=re.escape(said)) as raised:
            call()
        assert "--" not in str(raised.value)
        assert main(words) == 2
        assert flag in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "text", "said"),
    [
        ("generate", "max_attempts = 11. Allowed: 1 to 10.", "--attempts 11. Allowed: 1 to 10."),
        ("generate", "Try: num_threads=0, which takes", "Try: --threads 0, which takes"),
        ("generate", "Try: method='clear'.", "Try: --method clear."),
        ("generate", "objects=('mug', 'bowl')", "--objects mug bowl"),
        ("generate", "repeat=True or render=False", "--repeat or --no-render"),
        ("generate", "another `out`, or `overwrite`", "another --out, or --overwrite"),
        # A config's field is a flag of the command that has it.
        ("render", "View.azimuth = -500. Allowed", "--azimuth -500. Allowed"),
        # What the command has no option for, or what is no argument, stays.
        ("export", "num_threads = -1", "num_threads = -1"),
        ("generate", "`cluttergen generate` of my_method = 3", "`cluttergen generate` of my_method = 3"),
        # The first words of a command are no flags.
        ("verify", "path = 'x'", "path = 'x'"),
        ("doctor", "out = 3", "out = 3"),
    ],
)
def test_arguments_become_flags(command, text, said):
    assert with_flags(text, COMMANDS[command].load()) == said


def test_the_library_speaks_of_no_flags():
    """But for whole commands, which say `cluttergen` first."""
    package = ROOT / "cluttergen_jax"
    skipped = {package / "cli", package / "evaluation", package / "export" / "scripts"}
    for path in package.rglob("*.py"):
        if skipped & set(path.parents):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith("Error"):
                continue
            for text in map(ast.unparse, [*node.args, *(each.value for each in node.keywords)]):
                if flag := re.search(r"(?<![\w-])--[a-z]", text):
                    assert "cluttergen " in text[: flag.start()], f"{path.name}: {text}"


def test_errors_hold_what_they_say():
    assert issubclass(ConfigError, ClutterGenError)
    assert str(ConfigError("a = 1", "2", "a=2")) == "a = 1. Allowed: 2. Try: a=2."
