"""Scripts that lie beside an export say which versions of their host are known, before they do anything."""

import ast
import importlib.metadata
import importlib.util
import re
import runpy
import sys
import warnings
from pathlib import Path

import numpy as np
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


def checks():
    """What is in the file that travels."""
    return runpy.run_path(str(SCRIPTS / HOST_CHECKS))


def check_with(monkeypatch, version, known, install):
    """Runs the check where each package has the version that a function says."""
    monkeypatch.setattr("importlib.metadata.version", version)
    checks()["check_versions"](known, install, ("pathlib",))


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
        checks()["check_versions"]({"no-such-package": ("1.5.",)}, "it", ())


@pytest.mark.parametrize("name", sorted({*CHECKED, "mjlab"} - {"robocasa"}))
def test_without_the_host_the_first_thing_said_is_what_to_install(name, monkeypatch):
    if name == "mjlab":
        hidden = ["mjlab"]
    else:
        tree = ast.parse((SCRIPTS / f"cluttergen_{name}.py").read_text())
        calls = [node for node in tree.body if isinstance(node, ast.Expr)]
        (call,) = (each.value for each in calls if "check_versions" in ast.unparse(each))
        hidden = list(ast.literal_eval(call.args[2]))
    for module in hidden:
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda each: None if each in hidden else object()
    )
    monkeypatch.setattr(importlib.metadata, "version", refuse_version)
    monkeypatch.syspath_prepend(SCRIPTS)
    monkeypatch.delitem(sys.modules, "host_checks", raising=False)
    with pytest.raises(ImportError, match=r"not installed\. Try: pip install \S+==") as caught:
        runpy.run_path(str(SCRIPTS / f"cluttergen_{name}.py"))
    assert hidden[0] in str(caught.value)
    monkeypatch.delitem(sys.modules, "host_checks", raising=False)


def refuse_version(package):
    raise importlib.metadata.PackageNotFoundError(package)


@pytest.mark.parametrize(
    ("number", "known", "said"),
    [
        (8, range(8), "no scene 8 in out; there are 0 to 7"),
        ("-1", (0, 3), "no scene '-1' in out; there are 0, 3"),
        (1, (0, 3, 4, 5), "no scene 1 in out; there are 0, 3 to 5"),
        (2.0, range(8), "no scene 2.0"),
        ("a", (7,), "no scene 'a' in out; there are 7"),
        (0, (), "there are none"),
        (1, range(0, 40, 2), "there are 0, 2, 4, 6, 8, 10, 12, 14, ..."),
    ],
)
def test_a_scene_that_is_not_there_is_said_with_those_that_are(number, known, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        checks()["scene_number"](number, list(known), "out")


def test_a_scene_is_named_by_a_number_in_any_form():
    for given in (3, "3", np.int64(3)):
        assert checks()["scene_number"](given, [0, 3], "out") == 3


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
