"""The command line: quick to explain itself, every choice named, and a word for what was misspelt."""

import functools
import json
import os
import re
import shlex
import subprocess
import sys
from types import SimpleNamespace
from typing import get_args

import pytest

from cluttergen_jax import config
from cluttergen_jax.api.render import render
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.main import COMMANDS, load, main, overview, parse_words
from cluttergen_jax.errors import ClutterGenError
from cluttergen_jax.generation import generate, make_sampler
from cluttergen_jax.learning.training.presets import PRESETS
from cluttergen_jax.placement.methods.table import LEARNED, METHODS
from cluttergen_jax.placement.problem import ProblemConfig, make_problem
from cluttergen_jax.placement.region import REGION_CHANGES
from cluttergen_jax.scene.export.folder import BANK_FORMATS
from cluttergen_jax.scene.export.formats import FORMATS

HEAVY = {
    "jax",
    "mujoco",
    "flax",
    "brax",
    "scipy",
    "trimesh",
    "coacd",
    "pyarrow",
    "matplotlib",
    "PIL",
}
EXPLAINED = """
import json, sys
from cluttergen_jax.cli.main import main
found = {}
for words in json.loads(sys.argv[1]):
    main(words)
    found[" ".join(words)] = sorted(set(sys.modules) & set(json.loads(sys.argv[2])))
print("\\n" + json.dumps(found))
"""


def imported(*commands):
    """What of `HEAVY` is imported after each of several command lines, in one fresh process."""
    words = [json.dumps([list(each) for each in commands]), json.dumps([*HEAVY, "tyro", "numpy"])]
    done = subprocess.run(
        [sys.executable, "-c", EXPLAINED, *words], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_help_imports_nothing_heavy():

    found = imported(
        ["--help"], ["--version"], ["generat"], *([name, "--help"] for name in COMMANDS)
    )
    assert found.pop("--help") == found.pop("--version") == found.pop("generat") == []
    assert set(found) == {f"{name} --help" for name in COMMANDS}
    assert {each for modules in found.values() for each in modules} <= {"tyro", "numpy"}


def test_the_table_of_commands_says_what_their_docstrings_say():
    for name, about in COMMANDS.items():
        command = load(name)
        doc = command.__doc__
        assert about == doc.splitlines()[0], name
        assert f"  {name:<12}{about}" in overview()
        # The example is one that the command itself understands.
        examples = re.findall(r"`cluttergen (\S+)([^`]*)`", doc.split("Example: ")[1])
        assert examples
        for called, words in examples:
            assert called == name
            assert isinstance(parse_words(command, name, shlex.split(words)), command)


@pytest.mark.parametrize(
    ("words", "known"),
    [
        (config.Method, METHODS),
        (config.Variant, LEARNED),
        (config.Preset, PRESETS),
        (config.Change, REGION_CHANGES),
        (config.ExportFormat, (*FORMATS, *BANK_FORMATS)),
    ],
)
def test_choices_are_all_that_there_is(words, known):
    assert get_args(words) == tuple(known)


# Misspelt names


@pytest.mark.parametrize(
    ("ask", "meant"),
    [
        (lambda: find_pool("dinning"), "dining"),
        (lambda: find_pool("dining")["mugg"], "mug"),
        (lambda: find_support("tabel"), "table"),
        (lambda: make_sampler(num_object=3), "num_objects"),
        (lambda: make_sampler(method="polcy"), "policy"),
        (lambda: make_sampler(engine="natve"), "native"),
        (lambda: make_sampler(order="fixd"), "fixed"),
        (lambda: make_problem(ProblemConfig(change="rotatoin")), "rotation"),
    ],
)
def test_what_was_meant_is_said(ask, meant):
    with pytest.raises(ClutterGenError, match=f"Did you mean '{meant}'\\?"):
        ask()


def test_a_misspelt_command_is_told_what_was_meant(capsys):
    assert main(["generat", "--pool", "dining"]) == 2
    said = capsys.readouterr().err
    assert "no command is called 'generat'. Did you mean 'generate'? Allowed: " in said


# What cannot be met is said before anything is compiled


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--num-objects", "50"],
            "50 objects asked for, 10 chosen of pool 'dining'. Allowed: 1 to 10,",
        ),
        (
            ["--num-objects", "3", "--objects", "mug", "bowl"],
            "3 objects asked for, 2 chosen of pool 'dining'",
        ),
        (["--support", "table-0.1x0.1"], "footprints cover 10.6 times its area"),
    ],
)
def test_a_request_that_cannot_be_met_is_refused_at_once(
    words, said, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(generate, "run_blocks", None)
    assert main(["generate", *words, "--out", str(tmp_path / "bank")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "bank").exists()


# Errors that name a path once, and speak of what was given


def test_what_samples_scenes_loads_neither_trainers_nor_importers():
    code = "import sys, cluttergen_jax.generation.generate; print(*sorted(set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "jax" in done.stdout.split()
    heavy = {"brax", "warp", "trimesh", "orbax", "optax", "scipy"}
    assert not heavy & set(done.stdout.split())


def test_what_draws_scenes_of_a_bank_loads_no_readers_of_files():
    code = (
        "import sys, cluttergen_jax.generation.sources.rendering, cluttergen_jax.views.dataset;"
        "print(*sorted(set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "jax" in done.stdout.split()
    assert not {"brax", "warp", "trimesh", "orbax", "optax", "scipy"} & set(done.stdout.split())


@pytest.mark.slow
def test_what_a_command_compiles_the_next_one_finds(tmp_path):
    """All of `generate` is kept on disk: a program that calls back into Python could not be."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    environment |= {
        "CLUTTERGEN_HOME": str(tmp_path),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    programs = []
    for seed in ("0", "1"):
        words = ["generate", "--method", "clear", "-n", "1", "--max-files", "0", "--seed", seed]
        words = [sys.executable, "-m", "cluttergen_jax", *words, "--out", str(tmp_path / seed)]
        subprocess.run(words, env=environment, capture_output=True, check=True)
        programs.append({path.name for path in tmp_path.glob("programs/*/*-cache")})
    assert {"jit_propose", "jit_judge", "jit_conclude"} <= {
        name.split("-")[0] for name in programs[0]
    }
    assert programs[0] == programs[1]


@pytest.mark.parametrize(("words", "azimuth"), [("", None), ("--azimuth 90", 90.0)])
def test_a_view_that_is_not_asked_for_is_left_to_the_function(words, azimuth):
    told = {}

    @functools.wraps(render)
    def note(source, **options):
        told.update(options)
        return SimpleNamespace(is_whole=True)

    options = parse_words(load("render"), "render", ["bank", *words.split()])
    options.call(note)
    assert getattr(told.get("view"), "azimuth", None) == azimuth
