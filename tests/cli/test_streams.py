"""Standard streams that are closed, full or read no further: work and exit status are as with open ones."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cluttergen_jax.cli.flags import error_with_flags
from cluttergen_jax.cli.main import load
from cluttergen_jax.errors import BankError, ConfigError, range_text
from cluttergen_jax.files import writing
from cluttergen_jax.progress import Progress
from cluttergen_jax.spec import SceneSpec

BANK = Path(__file__).parents[1] / "golden" / "bank"
REDIRECTIONS = ("<&-", ">&-", "2>&-", "2>/dev/full", "2>&1 | head -c 0")


def shell(redirection, *words):
    """What a command line answers whose streams are redirected so; its own status, not that of a pipe."""
    command = [
        "bash",
        "-c",
        f'"$@" {redirection}; exit "${{PIPESTATUS[0]}}"',
        "bash",
        sys.executable,
    ]
    return subprocess.run(
        [*command, "-m", "cluttergen_jax", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
    )


def made(folder, redirection):
    """A bank that is verified in a shell, as its files."""
    shutil.copytree(BANK, folder)
    quickly = ("--allow-unchecked", "--seconds", "0.1", "--jobs", "1")
    done = shell(redirection, "verify", folder, *quickly)
    assert done.returncode == 0, (redirection, done.stderr)
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


@pytest.mark.parametrize(
    "redirections",
    [("<&- >&- 2>&-",), pytest.param(REDIRECTIONS, marks=pytest.mark.slow)],
    ids=["closed", "others"],
)
def test_a_bank_is_verified_whatever_becomes_of_the_streams(tmp_path, redirections):
    usual = made(tmp_path / "open", "")
    for place, redirection in enumerate(redirections):
        assert made(tmp_path / str(place), redirection) == usual, redirection


def test_an_error_has_its_status_without_streams():
    assert [shell(each, "list", "--no-such").returncode for each in ("2>&-", "<&- >&- 2>&-")] == [
        2,
        2,
    ]


def test_output_that_is_full_is_said_of_the_output():
    done = shell(">/dev/full", "list")
    assert done.returncode == 2
    assert "the output (stdout) cannot be written: No space left on device" in done.stderr
    assert "disk, then the same" not in done.stderr
    assert shell("| head -1", "list").stderr == ""


def test_the_reader_of_banks_says_so_too():
    command = [sys.executable, "-m", "cluttergen_jax.bank_reader", BANK]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: the output (stdout) cannot be written")


def test_progress_without_stderr_is_shown_nowhere(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    with Progress("drawing", 2, "picture") as progress:
        progress.say("a line")
        progress.update(2)
    assert progress.done == 2


def test_what_cannot_be_read_is_not_said_of_the_folder_that_is_written(tmp_path):
    with (
        pytest.raises(BankError, match=r"elsewhere/one: .* while .*bank was being written"),
        writing(tmp_path / "work" / "bank"),
    ):
        (tmp_path / "elsewhere" / "one").read_bytes()
    with (
        pytest.raises(BankError, match=r"bank cannot be written"),
        writing(tmp_path / "work" / "bank"),
    ):
        (tmp_path / "work" / "bank" / "one").read_bytes()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"weights": "*=0"}, "no object of pool 'dining' is drawn"),
        ({"weights": "*=0", "shelf": 3}, "no object of pool 'dining' is drawn"),
        (
            {"weights": "mug*=0", "num_objects": 10},
            "10 objects of 9 with a weight above 0. Allowed: 1 to 9",
        ),
        ({"shelf": 0}, "shelf = 0. Allowed: 1 to 10"),
    ],
)
def test_no_range_that_is_allowed_is_empty(options, said):
    with pytest.raises(ConfigError) as error:
        SceneSpec("dining", **options).problem_config("guided")
    assert said in str(error.value)
    assert "1 to 0" not in str(error.value)


def test_a_range_of_one_number_or_of_none_is_no_range():
    assert [range_text(1, 3), range_text(1, 1), range_text(1, 0, "a larger pool")] == [
        "1 to 3",
        "1",
        "a larger pool",
    ]


@pytest.mark.parametrize(
    "options", [{"budget": 0}, {"budget": 0, "num_objects": 4}, {"ruin_after": 10}]
)
def test_an_error_names_no_option_that_was_not_given(options):
    with pytest.raises(ConfigError) as error:
        SceneSpec("dining", **options)
    others = {"budget", "num_objects", "max_attempts", "ruin_after"} - options.keys()
    assert not any(f"{name} = " in error.value.given for name in others)


def test_an_option_that_was_not_given_is_said_to_be_so():
    error = ConfigError(
        "batch = 8 with seed = 0 and num_objects = 10 with num_scenes = 5", "seed = 1"
    )
    text = error_with_flags(error, load("generate")(seed=0, num_scenes=5))
    assert text == (
        "batch = 8 with --seed 0 (the default) and --num-objects 10 (not given) with --num-scenes 5. "
        "Allowed: --seed 1."
    )
