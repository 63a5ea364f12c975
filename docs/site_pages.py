"""MkDocs hook: pages made from the repository (README, examples, commands, package map), and links to them.

Nothing is written twice: the home page is the README, tutorials are the examples (which the tests run), and
the command reference is what `--help` prints.
"""

from __future__ import annotations

import ast
import contextlib
import io
import os
import posixpath
import re
import tomllib
from pathlib import Path
from typing import Annotated, get_args, get_origin, get_type_hints

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from cluttergen_jax.cli.commands import COMMANDS, load
from cluttergen_jax.cli.main import main

ROOT = Path(__file__).parents[1]
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changes.md",
    "benchmarks/README.md": "benchmarks.md",
} | {
    f"examples/{path.name}": f"tutorials/{path.stem}.md" for path in sorted((ROOT / "examples").glob("*.py"))
}
"""Files of the repository outside docs, and the pages that they become."""
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
_COLUMNS = "100"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are made."""
    for source, uri in PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        content = _tutorial(text, source) if source.endswith(".py") else text
        files.append(File.generated(config, uri, content=content))
    files.append(File.generated(config, "reference/commands.md", content=_commands()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links of the repository become links of the site; the package map is drawn."""
    uri = page.file.src_uri
    source = next((path for path, made in PAGES.items() if made == uri), f"docs/{uri}")

    def relinked(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[1]))
        inside = PAGES.get(target, target.removeprefix("docs/"))
        return posixpath.relpath(inside, posixpath.dirname(uri) or ".") + (match[2] or "")

    markdown = _LINK.sub(relinked, _without_code_links(markdown, source))
    if uri == "contributing.md":
        # On the site the drawing stands where the file has its list.
        markdown = re.sub(r"(?<=## Package layout\n\n)(?: {4}.+\n)+", _package_map() + "\n", markdown)
    return markdown


def _without_code_links(markdown: str, source: str) -> str:
    """Links to files that are no page, such as modules, lose their target: the text names the file."""

    def told(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[2].partition("#")[0]))
        is_page = target in PAGES or target.startswith("docs/")
        return match[0] if is_page else match[1]

    return re.sub(r"(?<!!)\[([^\]]*)\]\((?![a-z]+:|#)([^)\s]+)\)", told, markdown)


def _tutorial(text: str, source: str) -> str:
    """A script in cells (`# %%`) as a page: comments of Markdown cells as text, the others as code."""
    parts = []
    for cell in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        kind, _, body = cell.partition("\n")
        if kind.strip() == "[markdown]":
            parts.append(re.sub(r"^# ?", "", body.strip(), flags=re.MULTILINE))
        else:
            parts.append(f"```python\n{body.strip()}\n```")
    parts.append(f"The whole program is `{source}`.")
    return "\n\n".join(parts) + "\n"


def _commands() -> str:
    """What each command says of itself."""
    os.environ["COLUMNS"] = _COLUMNS
    parts = ["# Command line", "What `cluttergen COMMAND --help` prints."]
    for name, about in COMMANDS.items():
        parts.append(f"## {name}\n\n{about}")
        for action in _actions(name) or [""]:
            title = f"### {name} {action}\n\n" if action else ""
            parts.append(f"{title}```text\n{_help([name, *filter(None, [action])])}\n```")
    return "\n\n".join(parts) + "\n"


def _actions(name: str) -> list[str]:
    """The second words of a command that has such."""
    action = get_type_hints(load(name), include_extras=True).get("action")
    kinds = [get_args(each)[1] for each in get_args(action) if get_origin(each) is Annotated]
    return [kind.name for kind in kinds]


def _help(words: list[str]) -> str:
    """What a command prints of itself."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        main([*words, "--help"])
    return re.sub(r"\x1b\[[0-9;]*m", "", printed.getvalue()).strip()


def _package_map() -> str:
    """The layers of the import contract in pyproject.toml; each package has its docstring's first line."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    layers = next(each for each in contracts if each["type"] == "layers")["layers"]
    rows = []
    for height, layer in zip(range(len(layers) - 1, -1, -1), layers, strict=True):
        boxes = "".join(_box(name.strip()) for name in re.split(r"[|:]", layer))
        rows.append(f"<div><b>{height}</b>{boxes}</div>")
    return f'<div class="package-map">{"".join(rows)}</div>'


def _box(name: str) -> str:
    path = ROOT / "cluttergen_jax" / name
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    first = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).splitlines()[0]
    return f"<div><b>{name}</b><br>{first.replace('`', '')}</div>"
