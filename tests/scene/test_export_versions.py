"""Scripts that lie beside an export say which versions of their host are known, before they do anything."""

import ast
import warnings
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

import cluttergen_jax

SCRIPTS = Path(cluttergen_jax.__file__).parent / "scene" / "export" / "scripts"
CHECKED = ("dm_control", "libero", "maniskill", "newton", "playground", "robocasa", "robosuite")


def check_of(name, version):
    """A script's check alone, in an environment where each package has the version that a function says."""
    tree = ast.parse((SCRIPTS / f"cluttergen_{name}.py").read_text())
    wanted = [
        node
        for node in tree.body
        if getattr(node, "name", "") == "_check_versions"
        or (isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "KNOWN")
    ]
    assert len(wanted) == 2
    space = {
        "version": version,
        "warnings": warnings,
        "PackageNotFoundError": PackageNotFoundError,
    }
    exec(compile(ast.Module(wanted, []), name, "exec"), space)
    return space


@pytest.mark.parametrize("name", CHECKED)
def test_another_version_is_said_with_what_to_install(name):
    space = check_of(name, lambda package: "99.1")
    with pytest.warns(UserWarning, match="99.1; known: ") as caught:
        space["_check_versions"]()
    assert len(caught) == len(space["KNOWN"])
    for each, package in zip(caught, space["KNOWN"], strict=True):
        assert str(each.message).startswith(f"{package} 99.1")
        assert "pip install " in str(each.message)


@pytest.mark.parametrize("name", CHECKED)
def test_known_versions_are_silent(name):
    space = check_of(name, lambda package: f"{space['KNOWN'][package][-1]}0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        space["_check_versions"]()


@pytest.mark.parametrize("name", CHECKED)
def test_the_check_comes_before_anything_is_defined_that_simulates(name):
    tree = ast.parse((SCRIPTS / f"cluttergen_{name}.py").read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    lines = [node.lineno for node in calls if ast.unparse(node.func) == "_check_versions"]
    assert len(lines) == 1
    if name != "robocasa":
        first_class = min(
            node.lineno
            for node in tree.body
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name != "_check_versions"
        )
        assert lines[0] < first_class
