"""The documentation: it has every public name and every page of its menu, and builds without a warning."""

import ast
import html
import importlib
import json
import os
import re
import runpy
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli.main import COMMANDS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GUIDES = [DOCS / "start.md", *sorted(DOCS.glob("guide/*.md")), *sorted(DOCS.glob("concepts/*.md"))]
TEXTS = [ROOT / "README.md", ROOT / "AGENTS.md", *GUIDES]
PACKAGES = re.findall(r"reference/python/(\w+)\.md", (ROOT / "mkdocs.yml").read_text())
OPTIONS = json.loads((ROOT / "tests" / "cli" / "options.json").read_text())
SUITE_OPTIONS = json.loads((ROOT / "tests" / "studies" / "options.json").read_text())


def parts(name):
    """The names in a module that is a public name of the package; None for any other."""
    found = getattr(cg, name)
    return found.__all__ if isinstance(found, ModuleType) else [None]


def blocks(path, language):
    """The code blocks of a page."""
    return re.findall(rf"^```{language}\n(.*?)^```$", path.read_text(), re.M | re.S)


def anchors(path):
    """The anchors of a page's headings, as GitHub and MkDocs name them."""
    titles = re.findall(r"^#+ (.*)$", path.read_text(), re.M)
    plain = [re.sub(r"[^\w\- ]", "", title.lower()).strip() for title in titles]
    return {re.sub(r"[ -]+", "-", title) for title in plain} | {
        title.replace(" ", "-") for title in plain
    }


def test_people_need_not_read_much():
    assert len((ROOT / "README.md").read_text().split()) <= 700
    assert sum(len(path.read_text().split()) for path in GUIDES) <= 15_000
    assert (DOCS / "images" / "filling.gif").stat().st_size < 3e6


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_code_of_a_page_names_what_there_is(path):
    modules = {f"cg.{name}": parts(name) for name in cg.__all__ if parts(name) != [None]}
    for block in blocks(path, "python"):
        if block.startswith("class Physics(Protocol)"):
            continue
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("cluttergen_jax"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, name.name) for name in node.names), ast.unparse(node)
            if isinstance(node, ast.Attribute):
                name = ast.unparse(node.value)
                if name == "cg":
                    assert node.attr in cg.__all__
                elif name in modules:
                    assert node.attr in modules[name]


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
        options = SUITE_OPTIONS if name == "evaluate" and "--suite" in words else OPTIONS[name]
        known = {flag for flags in options for flag in flags.split(", ")} | {"--help"}
        assert {word for word in words if re.match(r"--?[a-z]", word)} <= known, line


def test_links_lead_to_pages_and_headings():
    pages = [ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md"), *TEXTS]
    for path in pages:
        for target, heading in re.findall(
            r"\]\((?![a-z]+:)([^)\s#]*)#?([^)\s]*)\)", path.read_text()
        ):
            found = (path.parent / target).resolve() if target else path
            # The records are not in the source distribution.
            if "reports" not in found.parts:
                assert found.exists(), f"{path.name}: {target}"
                assert not heading or heading in anchors(found), f"{path.name}: {target}#{heading}"


def test_every_public_name_is_in_the_reference():
    documented = re.findall(
        r"^::: cluttergen_jax\.([\w.]+)$", (DOCS / "reference" / "api.md").read_text(), re.M
    )
    assert len(documented) == len(set(documented))
    assert set(documented) == {
        name if each is None else f"{name}.{each}" for name in cg.__all__ for each in parts(name)
    }


def test_every_page_of_the_menu_exists():
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    hook = runpy.run_path(str(DOCS / "site_pages.py"))
    made = hook["PAGES"]
    packages = {f"reference/python/{name}.md" for name in hook["_PUBLIC"]}
    menu = re.findall(r"^ +- .*: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert len(menu) > 20
    written = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}
    assert (
        packages < set(menu) <= written | set(made.values()) | packages | {"reference/commands.md"}
    )
    assert all((ROOT / source).is_file() for source in made if not source.startswith("reports/"))


def test_the_search_finds_guides_before_references():
    """A title counts 1000 times as much as a word of a text (mkdocs-material)."""
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    boost_of = runpy.run_path(str(DOCS / "site_pages.py"))["boost_of"]
    for guide in ("guide/export.md", "start.md", "tutorials/04_bank.md", "index.md", "contract.md"):
        assert boost_of(guide) > boost_of("reference/commands.md")
        assert boost_of(guide) > 1000 * boost_of("reference/python/scene.md")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built with every warning an error."""
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    folder = tmp_path_factory.mktemp("docs") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    # `test_notebooks` runs them.
    env = os.environ | {"CLUTTERGEN_RUN_NOTEBOOKS": "0"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


class Shown(HTMLParser):
    """The text of a page as readers see it, without spaces."""

    def __init__(self, page):
        super().__init__()
        self.text = ""
        self._hidden = 0
        self.feed(page.read_text())
        self.text = without_spaces(self.text)

    def handle_starttag(self, tag, attrs):
        self._hidden += tag in ("script", "style", "svg")

    def handle_endtag(self, tag):
        self._hidden -= tag in ("script", "style", "svg")

    def handle_data(self, data):
        self.text += "" if self._hidden else data


def without_spaces(text):
    """A text as it can be looked for in a page: without spaces, and without the backticks of code."""
    return re.sub(r"[\s`]+", "", text)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_site_has_every_character_of_the_help(site, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    page = Shown(site / "reference" / "commands" / "index.html").text
    hook = runpy.run_path(str(DOCS / "site_pages.py"))
    for name in COMMANDS:
        for command in [f"{name} {action}" for action in hook["_actions"](name)] or [name]:
            # Titles of groups, and what `--help` says of itself, are in no page.
            _, _, said = hook["_help"](command.split()).partition("\n\n")
            said = re.sub(r"^.*\n *-{10,} *$", "", said, flags=re.MULTILINE)
            for line in said.splitlines():
                for part in re.split(r"(?<=\S) {2,}(?=\S)", line):
                    text = re.sub(r"\((default:.*|required\)|optional\))$", "", part.strip())
                    is_of_help = "--help" in line or "show this help" in line
                    assert is_of_help or without_spaces(text) in page, (command, line)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("package", PACKAGES)
def test_the_site_has_every_character_of_the_docstrings(site, package):
    page = Shown(site / "reference" / "python" / package / "index.html").text
    for title, text in public_docstrings(ROOT / "cluttergen_jax" / package):
        for line in text.splitlines():
            # Titles of sections, and names of arguments, are laid out in tables; marks of lists are drawn.
            part = re.sub(r"^\s*(- |[A-Z][a-z]+:$|[\w, ]+: )", "", line)
            assert without_spaces(part) in page, (title, line)


def public_docstrings(folder):
    """Of the modules of a package, their functions and classes, and their methods."""
    for path in sorted(folder.rglob("*.py")):
        if any(part.startswith("_") or part == "scripts" for part in path.relative_to(ROOT).parts):
            continue
        tree = ast.parse(path.read_text())
        kinds = (ast.FunctionDef, ast.ClassDef)
        for node in (each for each in tree.body if isinstance(each, kinds)):
            inner = node.body if isinstance(node, ast.ClassDef) else []
            for each in [node, *(some for some in inner if isinstance(some, ast.FunctionDef))]:
                if not (node.name.startswith("_") or each.name.startswith("_")):
                    yield f"{path.name} {node.name} {each.name}", ast.get_docstring(each) or ""


@pytest.mark.parametrize(
    "text",
    [
        'weights: "mug*=3; label=*book*=0.5"',
        "x |y| \\* _z_ a_b_c f32[N](x) infos[i][j] <ph> &lt; &amp {.a} # **b** ~c~ ^d^ ![e](f) <!-- g -->",
        "# a title\n: a definition\n!!! a note",
        "a tick ` alone, and <https://x.y>",
    ],
)
def test_markdown_of_a_text_shows_each_character(text):
    markdown = pytest.importorskip("markdown", reason="needs the extra docs")
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    escaped = runpy.run_path(str(DOCS / "site_pages.py"))["escaped"]
    extensions = ["admonition", "attr_list", "def_list", "md_in_html", "tables"]
    page = markdown.markdown(f"before {escaped(text)} after", extensions=extensions)
    assert html.unescape(re.sub(r"<[^<>]*>", "", page)) == f"before {text} after"
    assert set(re.findall(r"<(\w+)", page)) == {"p"}


def test_code_in_a_text_stays_code():
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    escaped = runpy.run_path(str(DOCS / "site_pages.py"))["escaped"]
    text = "See `a*b` and ``c`*``.\n\n    many * <b>\n    more"
    assert escaped(text) == text


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_site_has_its_pages(site):
    pages = {str(path.relative_to(site)) for path in site.rglob("*.html")}
    assert {"index.html", "reference/api/index.html", "reference/commands/index.html"} <= pages
    entries = json.loads((site / "search" / "search_index.json").read_text())["docs"]
    boosts = {each["location"]: each.get("boost", 1) for each in entries}
    assert (
        boosts["guide/export/"] > boosts["reference/commands/"] > boosts["reference/python/scene/"]
    )
    assert "make_sampler" in (site / "reference" / "api" / "index.html").read_text()
    commands = (site / "reference" / "commands" / "index.html").read_text()
    assert all(
        f'id="{anchor}"' in commands
        for anchor in ("generate-pool", "robot-place-placer", "verify-jobs")
    )
