"""Downstream takes few names of the core, and takes them from what its packages offer."""

import ast
from collections.abc import Iterator
from pathlib import Path

import cluttergen_jax

PACKAGE = Path(cluttergen_jax.__file__).parent
CORE = "cluttergen_jax"
DOWNSTREAM = f"{CORE}.downstream"

# The bar is 60 names of 12 packages: these numbers only go down.
MOST_NAMES = 227
MOST_PACKAGES = 24


def imports_of(path: Path) -> Iterator[tuple[str, str]]:
    """Modules and names that a file imports of this package; the name is "" for a whole module."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for each in node.names:
                yield each.name, ""
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports say where from"
            for each in node.names:
                yield str(node.module), each.name


def taken_from_core() -> set[tuple[str, str]]:
    """Modules of the core and the names that downstream imports from them."""
    taken: set[tuple[str, str]] = set()
    for path in (PACKAGE / "downstream").rglob("*.py"):
        for module, name in imports_of(path):
            is_ours = module == CORE or module.startswith(f"{CORE}.")
            if is_ours and module != DOWNSTREAM and not module.startswith(f"{DOWNSTREAM}."):
                taken.add((module, name))
    return taken


def offered_by(module: str) -> set[str] | None:
    """`__all__` of a package as its file writes it, or what it hands to `offer`; None for a module."""
    folder = PACKAGE.joinpath(*module.split(".")[1:])
    if not folder.is_dir():
        return None
    tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "offer":
            modules = ast.literal_eval(node.args[1])
            return {name for names in modules.values() for name in names}
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def test_names_come_from_packages_that_offer_them():
    for module, name in sorted(taken_from_core()):
        assert module.count(".") <= 1, f"{name or module}: from inside of {module}"
        offered = offered_by(module)
        assert offered is None or name in offered, f"{module} does not offer {name!r}"


def test_names_of_the_core_are_few():
    taken = taken_from_core()
    packages = {module for module, _ in taken}
    assert len(taken) <= MOST_NAMES, sorted(taken)
    assert len(packages) <= MOST_PACKAGES, sorted(packages)


def test_what_is_offered_exists_where_it_is_said_to_be():
    for path in PACKAGE.glob("*/__init__.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "offer":
                told = {
                    (f"{CORE}.{path.parent.name}.{module}", name)
                    for module, names in ast.literal_eval(node.args[1]).items()
                    for name in names
                }
                assert told == set(imports_of(path)) - {
                    ("typing", "TYPE_CHECKING"),
                    (f"{CORE}.lazy", "offer"),
                }, f"{path}: what type checkers see is not what is offered"
