"""Scripts that lie beside an export say which versions of their host are known, before they do anything."""

import ast
import runpy
import warnings
from pathlib import Path

import pytest

import cluttergen_jax
from cluttergen_jax.scene.export.folder import BANK_FORMATS
from cluttergen_jax.scene.export.formats import FORMATS, HOST_CHECKS

SCRIPTS = Path(cluttergen_jax.__file__).parent / "scene" / "export" / "scripts"
CHECKED = ("dm_control", "libero", "maniskill", "newton", "playground", "robocasa", "robosuite")


def checks_of(name):
    """The versions that a script knows, and the lines of its calls of `check_versions` with their words."""
    tree = ast.parse((SCRIPTS / f"cluttergen_{name}.py").read_text())
    (known,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "KNOWN"
    )
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    found = [node for node in calls if ast.unparse(node.func) == "check_versions"]
    assert [ast.unparse(node.args[0]) for node in found] == ["KNOWN"]
    return known, found[0].lineno, ast.literal_eval(found[0].args[1])


def check_with(monkeypatch, version, known, install):
    """Runs the check where each package has the version that a function says."""
    monkeypatch.setattr("importlib.metadata.version", version)
    runpy.run_path(str(SCRIPTS / HOST_CHECKS))["check_versions"](known, install)


@pytest.mark.parametrize("name", CHECKED)
def test_another_version_is_said_with_what_to_install(name, monkeypatch):
    known, _, install = checks_of(name)
    with pytest.warns(UserWarning, match="99.1; known: ") as caught:
        check_with(monkeypatch, lambda package: "99.1", known, install)
    assert len(caught) == len(known)
    for each, package in zip(caught, known, strict=True):
        assert str(each.message).startswith(f"{package} 99.1")
        assert f"pip install {install}" in str(each.message)


@pytest.mark.parametrize("name", CHECKED)
def test_known_versions_are_silent(name, monkeypatch):
    known, _, install = checks_of(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_with(monkeypatch, lambda package: f"{known[package][-1]}0", known, install)


def test_a_package_without_a_number_is_said(monkeypatch):
    with pytest.warns(UserWarning, match="no-such-package of no known version; known: 1.5"):
        runpy.run_path(str(SCRIPTS / HOST_CHECKS))["check_versions"](
            {"no-such-package": ("1.5.",)}, "it"
        )


@pytest.mark.parametrize("name", CHECKED)
def test_the_check_comes_before_anything_is_defined_that_simulates(name):
    tree = ast.parse((SCRIPTS / f"cluttergen_{name}.py").read_text())
    _, line, _ = checks_of(name)
    if name != "robocasa":
        first = min(
            node.lineno for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)
        )
        assert line < first


def test_the_checks_travel_with_each_script_that_asks_for_them():
    for kind in (*FORMATS.values(), *BANK_FORMATS.values()):
        texts = [(SCRIPTS / script).read_text() for script in kind.scripts]
        asks = any("from host_checks import" in text for text in texts)
        assert asks == (HOST_CHECKS in kind.scripts), kind.name
