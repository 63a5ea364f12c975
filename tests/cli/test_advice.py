"""Advice of errors is followed word by word: it leads out of the error that gave it."""

import ast
import json
import re
import shlex
from pathlib import Path

import pytest

import cluttergen_jax
from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.cli.main import COMMANDS, main
from cluttergen_jax.placement import problem
from tests.helpers.error_calls import error_calls
from tests.helpers.worlds import box

PACKAGE = Path(cluttergen_jax.__file__).parent
OPTIONS = json.loads((Path(__file__).parent / "options.json").read_text())
ANY = {flag for options in OPTIONS.values() for flags in options for flag in flags.split(", ")}


class ReachedError(Exception):
    """Everything that is asked for was accepted: worlds would be compiled now."""


@pytest.fixture(autouse=True)
def nothing_is_compiled(monkeypatch):
    def reached(*args, **kwargs):
        raise ReachedError

    monkeypatch.setattr(problem, "make_world", reached)


@pytest.fixture(scope="module")
def pools(tmp_path_factory):
    """Pools of a few boxes: some fit anywhere, one is too long for a small bin, one too tall for a shelf."""
    root = tmp_path_factory.mktemp("pools")
    small = [box(f"box-{number}", (0.02, 0.02, 0.02)) for number in range(3)]
    extra = {"long": box("plank", (0.2, 0.15, 0.01)), "tall": box("pole", (0.02, 0.02, 0.4))}
    return {
        name: write_pool(root / name, Pool(name, (*small, each))) for name, each in extra.items()
    }


def outcome(words, capsys):
    """What a command says that is refused; "" for one that is not."""
    try:
        status = main(words)
    except ReachedError:
        status = 0
    said = capsys.readouterr().err
    return said[said.index("error: ") :] if status == 2 else ""


def follow(words, said):
    """The words of a command, changed as an error advises."""
    if meant := re.search(r"'([^']*)'.*Did you mean '([^']*)'\?", said):
        # The misspelt name, wherever it is among the words.
        return [
            re.sub(rf"(?<![\w-]){re.escape(meant[1])}(?![\w-])", meant[2], word) for word in words
        ]
    hint = said.partition("Try: ")[2].strip().rstrip(".")
    if found := re.match(r"(?:leaving out )?--no-([a-z-]+)", hint):
        return [word for word in words if word != f"--{found[1]}"]
    if hint.startswith("--"):
        # One option, or several with commas between; what comes after "or" is another way.
        for each in re.split(r", (?=--)", re.split(r",? or ", hint)[0]):
            option, *values = shlex.split(re.split(r",? (?:\(|which )", each)[0])
            words = with_option(words, option, values)
        return words
    value = shlex.split(re.split(r",| or ", hint)[0])
    if option := re.search(r"--[a-z-]+", said):
        return with_option(words, option[0], value)
    given = re.search(r"'([^']*)'", said)
    assert given, f"nothing that could be replaced is named in {said}"
    assert given[1] in words, f"nothing that could be replaced is named in {said}"
    return [value[0] if word == given[1] else word for word in words]


def with_option(words, option, values):
    """The words with an option of these values, in place of those that it had."""
    if option in words:
        place = words.index(option)
        last = place + 1
        while last < len(words) and not words[last].startswith("--"):
            last += 1
        words = [*words[:place], *words[last:]]
    return [*words, option, *values]


REFUSED = [
    "--region 2x2",
    "--region 0.9,0,0.3,0.3",
    "--region 3x0.2 --support bookcase",
    "--region 30x30",
    "--num-objects 99",
    "--num-objects 30 --repeat --region 0.05x0.05 --method random",
    "--objects mug* --num-objects 5",
    "--objects mugs*",
    "--objects height>9",
    "--objects hieght>0.1",
    "--objects mgu",
    "--pool dinning",
    "--support tabel",
    "--support tote-0.001x0.4",
    "--layout brakfast_for_two",
    "--relations 'hardbak_book on laptop' --pool study",
    "--relations 'hardback_book on labtop' --pool study",
    "--relations 'bowl onn dinner_plate'",
    "--relations 'mug on dinner_plat'",
    "--relations 'mug on bowl' 'fork on bowl' 'cereal_box on dinner_plate' --num-objects 2",
    "--relations 'mug on bowl' --method random",
    "--relations 'mug on bowl' --surface all --support bookcase",
    "--roles 'cup_1=mgu*' --relations 'cup_1 on bowl'",
    "--weights mug",
    "--weights 'mgu*=2'",
    "--clutter stack=99",
    "--clutter stak=3",
    "--clutter stack",
    "--clutter stack=2 --method random",
    "--clutter near=0.02 --method packed",
    "--natural --method drop",
    "--natural --tidy",
    "--arrangements 'row mug'",
    "--arrangements 'rwo cereal_box' --repeat",
    "--arrangements 'stack bowl:3'",
    "--arrangements 'nest dinner_plate' --repeat",
    "--arrangements 'stack bowl' --repeat --method random",
    "--method packed --support tray --pool all --num-objects 20",
    "--clearance 0.01",
    "--clearance 5 --method packed",
    "--height free",
    "--poses any --method policy",
    "--max-attempts 0",
    "--max-attempts 3 --ruin-after 9",
    "--budget 3",
    "--min-margin 1",
    "--shelf 500",
    "--shelf 5 --num-objects 8",
    "--shelf 5 --repeat",
    "--num-threads -3",
    "--surface shelf9 --support bookcase",
    "--surface top:x --support rack",
    "--surface top:3,shelf_1:4 --num-objects 5 --support rack --pool study",
    "--surface all --region 0.2x0.2 --support bookcase --pool study",
    "--method pile --min-margin 0.003",
    "--method pile --num-objects 120 --repeat --support tray",
    "--method pile --support bin-0.20x0.16x0.10 --pool LONG --num-objects 4",
    "--method pile --support bin-0.20x0.16x0.10 --pool LONG --objects plank --num-objects 1",
    "--support bin-0.20x0.16x0.10 --pool LONG --objects plank box-1 --num-objects 1",
    "--surface shelf_1 --support rack --pool TALL --num-objects 3",
    "--surface shelf_1 --support rack --pool TALL --num-objects 2 --shelf 3",
]


QUICK = [
    "--region 2x2",
    "--num-objects 99",
    "--objects height>9",
    "--objects hieght>0.1",
    "--relations 'hardback_book on labtop' --pool study",
    "--roles 'cup_1=mgu*' --relations 'cup_1 on bowl'",
    "--weights 'mgu*=2'",
    "--surface top:x --support rack",
    "--shelf 5 --num-objects 8",
    "--method pile --support bin-0.20x0.16x0.10 --pool LONG --num-objects 4",
    "--arrangements 'row mug'",
    "--arrangements 'stack bowl:3'",
]


@pytest.mark.parametrize(
    "asked",
    [asked if asked in QUICK else pytest.param(asked, marks=pytest.mark.slow) for asked in REFUSED],
)
def test_the_advice_of_generate_works(asked, capsys, tmp_path, pools):
    asked = asked.replace("LONG", str(pools["long"])).replace("TALL", str(pools["tall"]))
    words = ["generate", "--out", str(tmp_path / "out"), *shlex.split(asked)]
    said = outcome(words, capsys)
    assert said, "it is not refused"
    assert "Try: " in said or "Did you mean" in said
    again = outcome(follow(words, said), capsys)
    assert again.split(". ")[0] != said.split(". ")[0], f"{said}\n{follow(words, said)}"
    # One more step may be needed, and no third.
    if again:
        assert outcome(follow(follow(words, said), again), capsys) == "", again


def hints():
    """The literal parts of every hint in the package: file, line, text."""
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text())
        # Hints that several errors share have a name.
        shared = {
            ast.unparse(each.targets[0]): each.value
            for each in tree.body
            if isinstance(each, ast.Assign)
        }
        for node in error_calls(tree):
            found = [*node.args[2:3], *(each.value for each in node.keywords if each.arg == "hint")]
            found = [shared.get(ast.unparse(each), each) for each in found]
            for part in (part for each in found for part in ast.walk(each)):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield f"{path.relative_to(PACKAGE)}:{node.lineno}", part.value


def test_commands_and_options_that_hints_name_exist():
    commands = 0
    options = 0
    for place, text in hints():
        for name, more in re.findall(r"cluttergen ([a-z][a-z-]*)((?: [a-z]+)?)", text):
            commands += 1
            assert name in COMMANDS, f"{place}: {text}"
            own = OPTIONS.get(name + more) or OPTIONS.get(name)
            for option in re.findall(r"(?<!\w)--[a-z][a-z-]+", text):
                options += 1
                known = {flag for flags in own or () for flag in flags.split(", ")} or ANY
                assert option in known | {"--help"}, f"{place}: {text}"
        own = re.sub(r"pip install --no-deps", "", text)
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", own):
            assert option in ANY | {"--help"}, f"{place}: {text}"
    assert commands > 20
    assert options > 5
