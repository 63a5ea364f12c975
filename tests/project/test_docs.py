"""The documentation: it has every public name and every page of its menu, and builds without a warning."""

import ast
import importlib
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import cluttergen_jax as cg

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GUIDES = [DOCS / "start.md", *sorted(DOCS.glob("guide/*.md")), *sorted(DOCS.glob("concepts/*.md"))]
TEXTS = [ROOT / "README.md", ROOT / "AGENTS.md", *GUIDES]
OPTIONS = json.loads((ROOT / "tests" / "cli" / "options.json").read_text())


def blocks(path, language):
    """The code blocks of a page."""
    return re.findall(rf"^```{language}\n(.*?)^```$", path.read_text(), re.M | re.S)


def anchors(path):
    """The anchors of a page's headings, as GitHub and MkDocs name them."""
    titles = re.findall(r"^#+ (.*)$", path.read_text(), re.M)
    plain = [re.sub(r"[^\w\- ]", "", title.lower()).strip() for title in titles]
    return {re.sub(r"[ -]+", "-", title) for title in plain} | {title.replace(" ", "-") for title in plain}


def test_people_need_not_read_much():
    assert len((ROOT / "README.md").read_text().split()) <= 700
    assert sum(len(path.read_text().split()) for path in GUIDES) <= 15_000
    assert (DOCS / "images" / "filling.gif").stat().st_size < 3e6


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_code_of_a_page_names_what_there_is(path):
    for block in blocks(path, "python"):
        if block.startswith("class Physics(Protocol)"):
            continue
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("cluttergen_jax"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, name.name) for name in node.names), ast.unparse(node)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "cg":
                assert node.attr in cg.__all__


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_commands_of_a_page_have_their_options(path):
    indented = re.findall(r"^ {4}((?:cluttergen|python) .*)$", path.read_text(), re.M)
    lines = "\n".join([*blocks(path, "bash"), *indented]).replace("\\\n", " ").splitlines()
    for line in lines:
        line = re.sub(r"\s#.*", "", line).replace("python train.py", "cluttergen train")
        words = line.replace("python evaluate.py", "cluttergen evaluate").split()
        if words[:1] != ["cluttergen"]:
            continue
        name = " ".join(words[1:3]) if " ".join(words[1:3]) in OPTIONS else words[1]
        known = {flag for flags in OPTIONS[name] for flag in flags.split(", ")} | {"--help"}
        assert {word for word in words if re.match(r"--?[a-z]", word)} <= known, line


def test_links_lead_to_pages_and_headings():
    pages = [ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md"), *TEXTS]
    for path in pages:
        for target, heading in re.findall(r"\]\((?![a-z]+:)([^)\s#]*)#?([^)\s]*)\)", path.read_text()):
            found = (path.parent / target).resolve() if target else path
            # The records are not in the source distribution.
            if "reports" not in found.parts:
                assert found.exists(), f"{path.name}: {target}"
                assert not heading or heading in anchors(found), f"{path.name}: {target}#{heading}"


def test_every_public_name_is_in_the_reference():
    documented = re.findall(r"^::: cluttergen_jax\.(\w+)$", (DOCS / "reference" / "api.md").read_text(), re.M)
    assert len(documented) == len(set(documented))
    assert set(documented) == set(cg.__all__)


def test_every_page_of_the_menu_exists():
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    hook = runpy.run_path(str(DOCS / "site_pages.py"))
    made, packages = hook["PAGES"], {f"reference/python/{name}.md" for name in hook["_PUBLIC"]}
    menu = re.findall(r"^ +- .*: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert len(menu) > 20
    written = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}
    assert packages < set(menu) <= written | set(made.values()) | packages | {"reference/commands.md"}
    assert all((ROOT / source).is_file() for source in made if not source.startswith("reports/"))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    pages = {str(path.relative_to(tmp_path / "site")) for path in (tmp_path / "site").rglob("*.html")}
    assert {"index.html", "reference/api/index.html", "reference/commands/index.html"} <= pages
    assert "make_sampler" in (tmp_path / "site" / "reference" / "api" / "index.html").read_text()
    commands = (tmp_path / "site" / "reference" / "commands" / "index.html").read_text()
    assert all(
        f'id="{anchor}"' in commands for anchor in ("generate-pool", "robot-place-placer", "verify-jobs")
    )
