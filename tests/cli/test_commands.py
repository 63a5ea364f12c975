"""The command line: quick to explain itself, every choice named, and a word for what was misspelt."""

import json
import os
import re
import shlex
import subprocess
import sys
from typing import get_args

import pytest

from cluttergen_jax import config
from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.cli.commands import COMMANDS, load, overview
from cluttergen_jax.cli.main import main, parsed
from cluttergen_jax.config import METHODS
from cluttergen_jax.downstream.suite import NAME as DOWNSTREAM
from cluttergen_jax.errors import ClutterGenError, ConfigError, closest
from cluttergen_jax.evaluation.suites import SUITES
from cluttergen_jax.generation import generate, make_sampler
from cluttergen_jax.learning.training.presets import PRESETS
from cluttergen_jax.physics.log import silent_import
from cluttergen_jax.placement.changes import REGION_CHANGES
from cluttergen_jax.placement.problem import ProblemConfig, crowding, make_problem
from cluttergen_jax.scene.export.formats import FORMATS
from tests.helpers.banks import two_scenes
from tests.helpers.worlds import box

HEAVY = {"jax", "mujoco", "flax", "brax", "scipy", "trimesh", "coacd", "pyarrow", "matplotlib", "PIL"}
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

    found = imported(["--help"], ["--version"], ["generat"], *([name, "--help"] for name in COMMANDS))
    assert found.pop("--help") == found.pop("--version") == found.pop("generat") == []
    assert set(found) == {f"{name} --help" for name in COMMANDS}
    assert {each for modules in found.values() for each in modules} <= {"tyro", "numpy"}


def test_help_that_no_one_reads_ends_in_silence():
    reader, writer = os.pipe()
    os.close(reader)
    words = [
        sys.executable,
        "-c",
        "from cluttergen_jax.cli.main import program; program(['train', '--help'])",
    ]
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_list_imports_no_jax():
    assert not {"jax", "flax", "brax"} & set(imported(["list"])["list"])


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
            assert isinstance(parsed(command, name, shlex.split(words)), command)


@pytest.mark.parametrize(
    ("words", "known"),
    [
        (config.Method, METHODS),
        (config.Preset, PRESETS),
        (config.Change, REGION_CHANGES),
        (config.Suite, (*SUITES, DOWNSTREAM)),
        (config.ExportFormat, FORMATS),
    ],
)
def test_choices_are_all_that_there_is(words, known):
    assert get_args(words) == tuple(known)


def test_completion_knows_commands_and_choices(tmp_path):
    script = tmp_path / "completion"
    assert main(["--tyro-write-completion", "bash", str(script)]) == 0
    text = script.read_text()
    for word in (*COMMANDS, *METHODS, *FORMATS, *PRESETS, *REGION_CHANGES, "native", "fixed"):
        assert re.search(rf"['\" ]{word}['\" ]", text), word


def test_a_wrong_choice_is_answered_with_the_right_ones(capsys):
    assert main(["generate", "--method", "polcy"]) == 2
    assert "'policy'" in capsys.readouterr().err


def test_the_version_is_told(capsys):
    assert main(["--version"]) == 0
    assert re.fullmatch(r"cluttergen_jax \d+\.\d+\.\d+\n", capsys.readouterr().out)


def test_without_a_command_the_commands_are_named(capsys):
    assert main([]) == 2
    assert "  generate  " in capsys.readouterr().out


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


def test_nothing_is_guessed_from_far_away():
    assert closest("zzz", ["dining", "study"]) == ""
    with pytest.raises(ClutterGenError) as raised:
        find_pool("zzz")
    assert "Did you mean" not in str(raised.value)


# What cannot be met is said before anything is compiled


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--num-objects", "50"], "50 objects asked for, 10 chosen of pool 'dining'. Allowed: 1 to 10,"),
        (
            ["--num-objects", "3", "--objects", "mug", "bowl"],
            "3 objects asked for, 2 chosen of pool 'dining'",
        ),
        (["--support", "table-0.1x0.1"], "footprints cover 10.6 times its area"),
    ],
)
def test_a_request_that_cannot_be_met_is_refused_at_once(words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(generate, "run_blocks", None)
    assert main(["generate", *words, "--out", str(tmp_path / "bank")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "bank").exists()


def test_a_sampler_is_asked_for_no_more_than_its_pool_holds():
    with pytest.raises(ConfigError, match="10 chosen of pool 'dining'"):
        make_sampler(num_objects=50)


def test_crowding_counts_the_smallest_objects_and_every_repeat():
    plates = [box(f"plate{side}", (side, side, 0.01)) for side in (0.1, 0.05, 0.15)]
    region = Rectangle((0.0, 0.0), (0.1, 0.25))
    assert crowding(plates, 1, region) == pytest.approx(0.1)
    assert crowding(plates, 2, region) == pytest.approx(0.5)
    assert crowding(plates, 4, region) == pytest.approx(1.5)


# Errors that name a path once, and speak of what was given


def test_a_file_of_a_bank_is_no_bank(tmp_path, capsys):
    two_scenes(tmp_path / "bank")
    (part,) = (tmp_path / "bank").glob("scenes-*.parquet")
    assert main(["verify", str(part)]) == 2
    said = capsys.readouterr().err
    assert f"cluttergen verify {tmp_path / 'bank'}." in said
    assert "again" not in said


@pytest.mark.parametrize(
    "words", [["generate", "--method", "policy", "--checkpoint"], ["import", "--pool", "mine"]]
)
def test_a_path_is_named_once(words, tmp_path, capsys, home):
    path = str(tmp_path / "nowhere")
    main([*words, path])
    assert capsys.readouterr().err.count(path) == 1


def test_only_remarks_on_missing_packages_are_left_out(capsys):
    with silent_import():
        print("Failed to import warp: No module named 'warp'")
        print("something else")
    assert capsys.readouterr().out == "something else\n"


def test_what_samples_scenes_loads_neither_trainers_nor_importers():
    code = "import sys, cluttergen_jax.generation.generate; print(*sorted(set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "jax" in done.stdout.split()
    assert not {"brax", "warp", "trimesh", "orbax", "optax"} & set(done.stdout.split())


@pytest.mark.slow
def test_what_a_command_compiles_the_next_one_finds(tmp_path):
    """All of `generate` is kept on disk: a program that calls back into Python could not be."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    environment |= {"CLUTTERGEN_HOME": str(tmp_path), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    programs = []
    for seed in ("0", "1"):
        words = ["generate", "--method", "clear", "-n", "1", "--max-files", "0", "--seed", seed]
        words = [sys.executable, "-m", "cluttergen_jax", *words, "--out", str(tmp_path / seed)]
        subprocess.run(words, env=environment, capture_output=True, check=True)
        programs.append({path.name for path in tmp_path.glob("programs/*/*-cache")})
    assert {"jit_propose", "jit_judge", "jit_conclude"} <= {name.split("-")[0] for name in programs[0]}
    assert programs[0] == programs[1]


@pytest.mark.slow
def test_mjx_says_nothing_of_warp():
    code = "import sys; sys.modules['warp'] = None; from cluttergen_jax.placement.brax_env import Env"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""
