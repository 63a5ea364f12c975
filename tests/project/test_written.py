"""What people write in YAML, JSON and TOML: each key once, of limited depth; all else ends in a sentence."""

import os

import pytest

from cluttergen_jax.downstream.robot.description import read_robot
from cluttergen_jax.errors import ClutterGenError, ConfigError
from cluttergen_jax.generation.layouts import read_layout
from cluttergen_jax.importing.settings import read_settings
from cluttergen_jax.schema import SchemaError, parse_toml, parse_written_json, parse_yaml
from cluttergen_jax.sensing.camera import parse_cameras

MERGED = "l0: &l0 {a: 1}\n" + "".join(
    f"l{i}: &l{i} {{<<: [*l{i - 1}, *l{i - 1}]}}\n" for i in range(1, 30)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 1\nb: 2\na: 3", "'a' comes twice.*line 3"),
        ("a: {b: 1, b: 2}", "'b' comes twice"),
        ("1: 2", "'1' is no text as a key"),
        ("on: 2", "'on' is no text as a key"),
        ("? [1, 2]\n: 3", "a list or a mapping is no text"),
        ("a: " + "[" * 51 + "]" * 51, "more than 50 deep"),
        ("[" * 100_000, "more than 50 deep"),
        ("a: &x [*x]", "repeats what it is part of"),
        ("a: &x 1\nb: [" + "*x, " * 101 + "]", "one of over 100"),
        (MERGED, "more than 10,000 keys"),
        ("a: !!python/object/apply:os.getcwd []", "constructor"),
        ("a: 2024-99-99", "month"),
        ('a: !!int ""', "not YAML"),
        ("a: \0", "unacceptable"),
        ("a: 1\n---\nb: 2", "single document"),
        ("a: [", "not YAML"),
    ],
)
def test_yaml_has_each_key_once_and_an_end(text, said):
    with pytest.raises(SchemaError, match=said):
        parse_yaml(text.encode())


def test_sound_yaml_is_what_it_says():
    text = "base: &base {x: 1, y: [1, 2]}\nother: {<<: *base, x: 3}\nsame: *base\n"
    found = parse_yaml(("\ufeff" + text).encode())
    assert found["other"] == {"x": 3, "y": [1, 2]}
    assert found["same"] == found["base"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": 1, "a": 2}', "'a' comes twice"),
        ('{"a": {"b": 1, "b": 1}}', "'b' comes twice"),
        ('{"a": NaN}', "NaN"),
        ("[" * 51 + "]" * 51, "more than 50 deep"),
        ("[" * 100_000, "not JSON"),
        ("9" * 5000, "not JSON"),
        ('{"a": 1} x', "not JSON"),
    ],
)
def test_json_has_each_key_once_and_an_end(text, said):
    with pytest.raises(SchemaError, match=said):
        parse_written_json(text.encode())


@pytest.mark.parametrize(
    "text", ["a = 1\na = 2", "a = " + "[" * 51 + "]" * 51, "a = " + "[" * 10**5]
)
def test_toml_has_each_key_once_and_an_end(text):
    with pytest.raises(SchemaError, match=r"TOML|deep"):
        parse_toml(text)


READERS = {
    "layout.yaml": read_layout,
    "robot.yaml": read_robot,
    "objects.toml": read_settings,
    "cameras.json": lambda path: parse_cameras([path]),
}


@pytest.mark.parametrize("name", READERS)
def test_odd_paths_and_files_end_in_a_sentence(tmp_path, name):
    read = READERS[name]
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / name).mkdir()
    os.mkfifo(tmp_path / name)
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / name).write_bytes(b"\xff\xfe\0")
    for path in (
        tmp_path / name,
        tmp_path / "folder" / name,
        tmp_path / "nowhere" / name,
        tmp_path / "x" / name,
        tmp_path / ("a" * 5000 + name),
        tmp_path / f"a\0{name}",
    ):
        with pytest.raises(ClutterGenError):
            read(path)


def test_a_key_twice_is_told_by_its_reader(tmp_path):
    (tmp_path / "a.yaml").write_text("objects: {a: mug}\nothers: 1\nothers: 2\n")
    (tmp_path / "b.json").write_text('{"cameras": [], "cameras": []}')
    for read, path in (
        (read_layout, "a.yaml"),
        (read_robot, "a.yaml"),
        (lambda p: parse_cameras([p]), "b.json"),
    ):
        with pytest.raises(ConfigError, match="comes twice"):
            read(tmp_path / path)
