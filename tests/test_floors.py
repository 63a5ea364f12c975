"""The package layout: a module imports only from floors below it, or from its own package."""

import ast
import re
from pathlib import Path

import cluttergen_jax

ROOT = Path(cluttergen_jax.__file__).parent
# Two floors lie between products and commands: `methods` names baselines and policies alike, and `sampler`
# puts together whatever a scene takes. Both look down on the products; commands and programs use them.
FLOORS = {
    "errors": 0,
    "geometry": 0,
    "types": 0,
    "config": 0,
    "files": 0,
    "progress": 0,
    "tables": 0,
    "assets": 1,
    "physics": 1,
    "networks": 1,
    "world": 2,
    "scene": 2.5,
    "placement": 2,
    "agent": 2,
    # Geometry for the products that propose poses; the ranking of its candidates stands on it.
    "search": 2.2,
    "ranking": 2.4,
    # What is trained and what acts are the same pair of an environment and an agent.
    "agents": 2.6,
    # What is trained is evaluated as it is sampled: by a policy, in blocks, on a compiled world.
    "problem": 2.7,
    "sampling": 2.7,
    "policies": 2.7,
    "training": 3,
    "baselines": 3,
    "bank": 3,
    "export": 3,
    "measures": 3,
    "render": 3,
    "viewer": 3,
    "importing": 3,
    "methods": 3.2,
    # What is measured of scenes, as columns of a bank.
    "certification": 3.2,
    "evaluation": 3.5,
    "sampler": 3.5,
    # What can be looked at, from wherever it comes.
    "sources": 3.7,
    "cli": 4,
    "__main__": 5,
}


def _module(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def _imported(path: Path) -> set[str]:
    """First names below `cluttergen_jax` that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            assert node.level == 0, f"{path}: relative import"
        found |= {name.split(".")[1] for name in names if name.startswith("cluttergen_jax.")}
    return found


def _files() -> list[Path]:
    # What is installed as data has scripts, too.
    found = (path for path in sorted(ROOT.rglob("*.py")) if path != ROOT / "__init__.py")
    return [path for path in found if path.relative_to(ROOT).parts[0] != "scenes"]


def test_every_module_has_a_floor():
    assert {_module(path) for path in _files()} == set(FLOORS)


def test_the_layout_page_puts_every_package_on_its_floor():
    page = (Path(__file__).parents[1] / "CONTRIBUTING.md").read_text()
    layout = page.split("## Package layout")[1].split("\n\n")[1]
    listed, floor = {}, 0.0
    for line in layout.splitlines():
        if number := re.match(r" +([\d.]+) ", line):
            floor = float(number[1])
        # What stands in brackets explains.
        listed |= dict.fromkeys(re.sub(r"\([^)]*\)", " ", line).split(), floor)
    listed["cli"] = listed.pop("cluttergen_jax/cli")
    packages = {name: floor for name, floor in FLOORS.items() if name != "__main__"}
    assert {name: listed.get(name) for name in packages} == packages


def test_imports_look_down():
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in _files()
        for name in _imported(path) - {_module(path)}
        if FLOORS.get(name, -1) >= FLOORS[_module(path)]
        and not (FLOORS[_module(path)] == 0 and name == "errors")
    ]
    assert wrong == []


def test_assets_import_no_jax():
    for path in (ROOT / "assets").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] in {"jax", "jaxlib", "flax", "jaxlie", "brax"} for n in names), (
                path
            )
