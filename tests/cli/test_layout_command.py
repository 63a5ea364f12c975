"""`cluttergen layout`: its schema, its status for sound and unsound layouts, and scenes from a sentence."""

import json
import signal
import subprocess
import sys
import time

import jsonschema
import pytest
import yaml

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main

GOOD = "objects: {mine: dinner_plate, my_mug: mug}\nrelations: [my_mug behind mine]\n"


@pytest.fixture
def model(tmp_path):
    """A command that answers with a mistake, and well when it is told."""
    path = tmp_path / "my_model.py"
    path.write_text(
        "import sys\n"
        f"good = {GOOD!r}\n"
        "print(good if 'Your last answer was' in sys.stdin.read() else good.replace('mug}', 'mgu}'))\n"
    )
    return f"{sys.executable} {path}"


@pytest.mark.parametrize("word", ["--schema", "schema"])
def test_the_schema_is_printed(word, capsys):
    assert main(["layout", word]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema == cg.layout_schema()


def test_the_status_of_a_check_says_whether_a_layout_is_sound(tmp_path, capsys):
    path = tmp_path / "meal.yaml"
    path.write_text(GOOD)
    assert main(["layout", "check", str(path)]) == 0
    assert capsys.readouterr().out == "sound: 2 objects, 1 relations\n"
    path.write_text(GOOD.replace("dinner_plate", "dinner_plat").replace("behind", "behnd"))
    assert main(["layout", "check", str(path)]) == 1
    first, *errors = capsys.readouterr().out.splitlines()
    assert first == "2 errors"
    assert [each.partition(":")[0] for each in errors] == ["objects.mine", "relations[0]"]
    # Of another pool the names are others.
    path.write_text(GOOD)
    assert main(["layout", "check", str(path), "--pool", "study"]) == 1
    assert "no object of pool 'study'" in capsys.readouterr().out
    assert main(["layout", "check", str(tmp_path / "meals.yaml")]) == 2
    assert main(["layout", "check", str(path), "--stability", "x"]) == 2


@pytest.mark.slow
def test_a_sentence_becomes_a_bank_whose_record_names_it(model, tmp_path, capsys):
    out = str(tmp_path / "bank")
    words = ["layout", "ask", "a meal", "--model", model, "--pool", "dining+kitchen", "--out", out]
    words += ["-n", "2", "--no-render"]
    assert main(words) == 0
    printed = capsys.readouterr()
    assert "asked 1 of 5: 1 error\nasked 2 of 5: sound\n" in printed.err
    assert "2 objects, 1 relations" in printed.out
    assert "2, of which 2 succeed" in printed.out
    bank = cg.read_bank(out)
    asked = bank.recipe["asked"]
    assert (asked["request"], asked["tries"]) == ("a meal", 2)
    assert asked["model"].endswith("my_model.py")
    assert "/" not in asked["model"]
    assert bank.recipe["pool"] == "dining+kitchen"
    assert bank.recipe["placement"]["relations"] == ["my_mug behind mine:0.15"]
    card = (bank.path / "README.md").read_text()
    assert "- layout asked for: 'a meal', of " in card
    assert yaml.safe_load((tmp_path / "bank.yaml").read_text())["asked"] == dict(asked)
    # The same command goes on with the same layout; the file alone makes the same bank.
    assert main(words) == 0
    assert "it is taken as it is" in capsys.readouterr().err
    again = cg.generate(out, layout=tmp_path / "bank.yaml", num_scenes=2, render=False)
    assert again.recipe == bank.recipe


def test_a_sentence_becomes_a_file_alone(model, tmp_path, capsys):
    out = tmp_path / "meal.yaml"
    words = ["layout", "ask", "a meal", "--model", model, "--out", str(out)]
    assert main([*words, "--num-scenes", "3"]) == 2
    assert "--num-scenes" in capsys.readouterr().err
    assert main([*words, "--relations", "a on b"]) == 2
    assert "--relations" in capsys.readouterr().err
    assert not out.exists()
    assert main(words) == 0
    assert yaml.safe_load(out.read_text())["pool"] == "all"
    assert {path.name for path in tmp_path.iterdir()} == {
        "my_model.py",
        "meal.yaml",
        "meal.answers.json",
    }


def test_a_model_that_fails_is_an_error(tmp_path, capsys):
    words = ["layout", "ask", "a meal", "--out", str(tmp_path / "bank"), "--model"]
    assert main([*words, "false"]) == 2
    assert "false ended with status 1" in capsys.readouterr().err
    assert main([*words, "echo objects:", "--max-tries", "1"]) == 2
    said = capsys.readouterr().err
    assert "no layout without errors in 1 answer of echo objects:" in said
    assert "objects: " in said
    assert not (tmp_path / "bank").exists()
    assert not (tmp_path / "bank.yaml").exists()


def test_ctrl_c_ends_a_model_that_is_waited_for(tmp_path):
    mark = tmp_path / "asked"
    slow = tmp_path / "slow.py"
    slow.write_text(f"import time\nopen({str(mark)!r}, 'w').close()\ntime.sleep(1000)\n")
    words = ["layout", "ask", "a meal", "--model", f"{sys.executable} {slow}"]
    process = subprocess.Popen(
        [sys.executable, "-m", "cluttergen_jax", *words, "--out", str(tmp_path / "meal.yaml")],
        stderr=subprocess.PIPE,
        text=True,
    )
    while not mark.exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert "stopped" in process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert {path.name for path in tmp_path.iterdir()} == {"asked", "slow.py"}
