"""The help of a command: everyday options first, the others in groups; each is called as its argument."""

import inspect
import json
import re
from pathlib import Path

import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli import downstream, layouts, learning, pools, scenes
from cluttergen_jax.cli.main import main
from cluttergen_jax.cli.options import Command
from cluttergen_jax.errors import BankError, ClutterGenError
from cluttergen_jax.spec import OPTION_GROUPS

OPTIONS = json.loads(Path(__file__).with_name("options.json").read_text())
ORDER = [name.replace("_", "-") for name in OPTION_GROUPS]
MANY = 15
"""A command with more options than these shows them in groups."""
COMMANDS = {
    f"{module.__name__.rpartition('.')[2]}.{name}": each
    for module in (scenes, learning, pools, downstream, layouts)
    for name, each in vars(module).items()
    if isinstance(each, Command)
}


def groups_in_help(name, capsys, monkeypatch, columns="80"):
    """The options of each group in a command's help, in their order."""
    monkeypatch.setenv("COLUMNS", columns)
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    parts = re.split(r"^\W*([a-z][a-z -]*?) *\n\W*-{10,}\W*$|^╭─ ([a-z -]*) ─*╮$", text, flags=re.M)
    titles = [
        ascii_title or title for ascii_title, title in zip(parts[1::3], parts[2::3], strict=True)
    ]
    return {
        title.removesuffix(" options"): re.findall(
            r"^[^\w-]{,3}(?:-\w [A-Z]+, )?--([a-z][\w-]*)", body, re.M
        )
        for title, body in zip(titles, parts[3::3], strict=True)
    }


@pytest.mark.parametrize("columns", ["80", "300"])
def test_twelve_everyday_options_come_first(columns, capsys, monkeypatch):
    found = groups_in_help("generate", capsys, monkeypatch, columns)
    # The first box says of itself how the help is called.
    assert list(found) == ["options", *ORDER]
    assert found["everyday"][:4] == ["num-scenes", "pool", "objects", "num-objects"]
    assert len(found["everyday"]) == 12
    assert found["where"] == ["surface", "keep-out", "start", "containment"]
    assert "num-threads" in found["machine"]


@pytest.mark.parametrize("name", [name for name, options in OPTIONS.items() if len(options) > MANY])
def test_a_long_help_has_groups_in_their_order(name, capsys, monkeypatch):
    found = groups_in_help(name, capsys, monkeypatch)
    assert 5 <= len(found["everyday"]) <= 12
    known = [title for title in found if title in ORDER]
    assert len(known) > 3
    assert known == sorted(known, key=ORDER.index)
    # Each option is in one group.
    shown = [flag for flags in found.values() for flag in flags]
    assert sorted(shown) == sorted({*shown})
    assert len(shown) == len(OPTIONS[name])


@pytest.mark.parametrize("name", COMMANDS)
def test_an_option_is_called_as_its_argument(name):
    command = COMMANDS[name]
    fields = command.options.__dataclass_fields__
    for function in command.functions or (command.run,):
        arguments = set(inspect.signature(function).parameters)
        assert arguments <= {*fields, *command.left_out, "show", "spec", "planner"}
    for field in fields.values():
        names = [getattr(note, "name", None) for note in getattr(field.type, "__metadata__", ())]
        assert not any(names), f"the option of {field.name} is called {names}"


@pytest.mark.parametrize(
    ("words", "new"),
    [
        ("generate --threads -1", "--num-threads"),
        ("generate --threads=-1", "--num-threads"),
        ("generate --attempts 99", "--max-attempts"),
        ("robot grasps dining --threads -1", "--num-threads"),
    ],
)
def test_a_former_name_of_an_option_works_and_names_the_new_one(words, new, capsys):
    assert main(words.split()) == 2
    note, error = capsys.readouterr().err.splitlines()
    assert re.fullmatch(rf"note: --\w+ is now called {new}", note)
    assert error.startswith(f"error: {new}")


def test_a_former_name_means_nothing_where_there_is_no_such_option(capsys):
    assert main(["verify", "bank", "--threads", "2"]) == 2
    said = capsys.readouterr().err
    assert "Unrecognized" in said
    assert "is now called" not in said


def test_a_former_name_of_an_argument_works_with_a_warning(tmp_path):
    with (
        pytest.warns(
            DeprecationWarning, match=r"push_bank\(is_private=...\) is now called private"
        ),
        pytest.raises(BankError),
    ):
        cg.push_bank(tmp_path / "none", "me/none", hub=str(tmp_path / "hub"), is_private=True)
    with (
        pytest.warns(DeprecationWarning, match=r"path=...\) is now called support"),
        pytest.raises(ClutterGenError),
    ):
        cg.import_support(path=tmp_path / "none.obj")
