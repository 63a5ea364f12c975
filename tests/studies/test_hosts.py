"""The program that runs scenes in every host: its table of hosts, what it keeps, and what it writes."""

import json
import sys
from dataclasses import asdict, replace
from typing import get_args

import pytest

from cluttergen_jax.config import ExportFormat
from cluttergen_jax.errors import ConfigError
from studies.hosts import __main__ as program
from studies.hosts import measurement, page
from studies.hosts.__main__ import HostsConfig, main
from studies.hosts.measurement import HostFolder, Measurement, read_measurement
from studies.hosts.table import HOSTS, Host

MOVES = (0.0001, 0.002, 0.0005)


def test_each_host_has_a_program_a_format_and_pins():
    for name, host in HOSTS.items():
        assert name == host.name
        assert host.program.is_file()
        assert host.format in get_args(ExportFormat)
        assert any("==" in each for each in host.packages)
        compile(host.program.read_text(), host.program.name, "exec")


@pytest.mark.parametrize("guide", page.GUIDES, ids=lambda guide: guide.stem)
def test_sections_of_guides_begin_with_the_command_of_the_table(guide):
    text = guide.read_text()
    assert page.with_commands(text) == text
    for host in HOSTS.values():
        if f"## {host.title}\n" in text:
            assert f"## {host.title}\n\n```bash\n{host.pip_line}\n" in text
    assert all(page.num_lines(host) for host in HOSTS.values() if host.name != "pybullet")


def test_the_table_in_the_guide_has_what_is_known_without_measuring():
    rows = [line.split("|") for line in page.PAGE.read_text().splitlines() if line.startswith("|")]
    in_guide = {row[1]: row for row in rows}
    for line in page.table_text({}).splitlines()[2:]:
        fresh = line.split("|")
        assert [in_guide[fresh[1]][column] for column in (2, 5, 6, 7)] == [
            fresh[column] for column in (2, 5, 6, 7)
        ]


def test_commands_are_put_in_and_replaced():
    host = HOSTS["newton"]
    bare = f"# Guide\n\n## {host.title}\n\n```python\nimport newton\n```\n\n## Other\n"
    once = page.with_commands(bare)
    assert f"## {host.title}\n\n```bash\n{host.pip_line}\n```\n\n```python" in once
    old = once.replace(host.pip_line, "pip install newton==0.1")
    assert page.with_commands(old) == once
    more = once.replace(host.pip_line, f"{host.pip_line}\nnewton --help")
    assert page.with_commands(more.replace(host.pip_line, "pip install newton")) == more
    assert page.with_commands(once) == once


def test_the_guide_gets_table_and_commands_and_keeps_the_rest(tmp_path):
    guide = tmp_path / "hosts.md"
    marks = "<!-- hosts: begin -->\nold\n<!-- hosts: end -->"
    guide.write_text(f"# Guide\n\n{marks}\n\n## Newton\n\nWords.\n")
    result = Measurement("newton", versions={}, moves=MOVES, is_finite=True, date="2026-01-02")
    for _ in range(2):
        page.write_page({"newton": result}, [guide])
    text = guide.read_text()
    assert "|Newton|" in text
    assert "2026-01-02" in text
    assert "old" not in text
    assert text.endswith(f"## Newton\n\n```bash\n{HOSTS['newton'].pip_line}\n```\n\nWords.\n")


def test_the_table_has_millimetres_of_the_worst_scene_and_says_what_fails():
    result = Measurement("newton", versions={"newton": "1.8.0"}, moves=MOVES, is_finite=True)
    broken = replace(result, is_finite=False)
    fault = Measurement("drake", fault="cannot be installed: no such version")
    text = page.table_text({"newton": result, "drake": fault, "dm_control": broken})
    rows = {line.split("|")[1]: line.split("|") for line in text.splitlines()}
    assert rows["Newton"][3:5] == ["newton 1.8.0", "2 (0.5)"]
    assert rows["dm_control"][4] == "not finite"
    assert rows["Drake"][3:5] == ["cannot be installed", "-"]
    assert rows["[PyBullet](export.md#pybullet)"][3] == "not measured"
    assert "[ManiSkill 3](export.md#maniskill-3)" in rows
    assert len(rows) == len(HOSTS) + 2


def test_a_host_of_another_python_is_told_where_there_is_none(host, tmp_path):
    (tmp_path / "out" / "environments" / "own" / "packages.json").unlink()
    folder = HostFolder(tmp_path / "out", 3, 10.0, 0)
    assert "no python9.9 is on the PATH" in folder.measure(replace(host, python="9.9"), print).fault


def test_an_interpreter_can_be_named(host, tmp_path, monkeypatch):
    monkeypatch.setenv("CLUTTERGEN_OWN_PYTHON", sys.executable)
    folder = HostFolder(tmp_path / "elsewhere", 3, 10.0, 0)
    assert folder.measure(host, print).moves == MOVES
    assert not (tmp_path / "elsewhere" / "environments").exists()


@pytest.fixture
def host(tmp_path, monkeypatch):
    """A host whose environment is there, whose export is empty, and that counts its runs."""
    program = tmp_path / "step_own.py"
    program.write_text(
        "import json, sys\n"
        "file = sys.argv[1] + '/runs'\n"
        "open(file, 'a').write('x')\n"
        "print('1 of 3', file=sys.stderr)\n"
        "print('x' * 200_000)\n"
        f"print(json.dumps({{'moves': {list(MOVES)}, 'is_finite': True, 'num_worlds': 3}}))\n"
    )
    own = Host("own", "Own", "mjcf", ("own==1",), (), "yes")
    monkeypatch.setattr(Host, "program", program)
    export = tmp_path / "export"
    export.mkdir()
    monkeypatch.setattr(HostFolder, "_export", lambda self, host: export)
    python = tmp_path / "out" / "environments" / "own" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.symlink_to(sys.executable)
    (python.parents[1] / "packages.json").write_text(json.dumps(own.packages))
    return own


def test_a_measurement_is_kept_and_not_made_again(host, tmp_path):
    notes = []
    folder = HostFolder(tmp_path / "out", 3, 10.0, 0)
    result = folder.measure(host, notes.append)
    assert (result.moves, result.fault, result.num_worlds) == (MOVES, "", 3)
    assert "own: 1 of 3" in notes
    assert folder.measure(host, notes.append) == result
    assert (tmp_path / "export" / "runs").read_text() == "x"
    assert HostFolder(tmp_path / "out", 3, 10.0, 0).results() == {"own": result}
    # Another setting is another measurement.
    HostFolder(tmp_path / "out", 4, 10.0, 0).measure(host, notes.append)
    assert (tmp_path / "export" / "runs").read_text() == "xx"


def test_a_program_that_fails_is_told_with_its_last_words_and_tried_again(host, tmp_path):
    program = host.program
    good = program.read_text()
    program.write_text("raise ValueError('no such field')")
    folder = HostFolder(tmp_path / "out", 3, 10.0, 0)
    fault = folder.measure(host, print).fault
    assert fault.startswith("fails: ")
    assert fault.endswith("ValueError: no such field")
    program.write_text(good)
    assert folder.measure(host, print).fault == ""


def test_an_environment_that_cannot_be_made_is_told(host, tmp_path, monkeypatch):
    def refuse(words, fault, note):
        raise measurement.HostError(f"{fault}: no matching distribution")

    (tmp_path / "out" / "environments" / "own" / "packages.json").unlink()
    monkeypatch.setattr(measurement, "_call", refuse)
    folder = HostFolder(tmp_path / "out", 3, 10.0, 0)
    assert folder.measure(host, print).fault == "cannot be installed: no matching distribution"
    assert folder.results()["own"].fault


def test_a_file_that_is_no_measurement_counts_as_none(tmp_path):
    file = tmp_path / "newton.json"
    for text in ("", "[]", '{"moves": 1}', json.dumps({**asdict(Measurement("own")), "x": 1})):
        file.write_text(text)
        assert read_measurement(file) is None
    assert read_measurement(tmp_path / "none.json") is None


def test_an_unknown_host_and_strange_numbers_are_refused(tmp_path):
    for given, said in (
        ({"hosts": ("newtn",)}, "newton"),
        ({"num_scenes": 0}, "num_scenes"),
        ({"seconds": 0.0}, "seconds"),
    ):
        with pytest.raises(ConfigError, match=said):
            main(HostsConfig(**given, out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_hosts_that_fail_make_the_status_and_the_others_are_measured(host, tmp_path, monkeypatch):
    broken = replace(host, name="broken", python="9.9")
    for module in (program, page):
        monkeypatch.setattr(module, "HOSTS", {"broken": broken, "own": host})
    assert main(HostsConfig(out=tmp_path / "out", num_scenes=3)) == 1
    results = HostFolder(tmp_path / "out", 3, 10.0, 87).results()
    assert results["own"].moves == MOVES
    assert "python9.9" in results["broken"].fault
    assert main(HostsConfig(hosts=("own",), out=tmp_path / "out", num_scenes=3)) == 0
