"""MkDocs hook: pages made from the repository (README, examples, reports, references), and links to them.

Nothing is written twice: the home page is the README, tutorials are the examples (which the tests run), the
command reference is what `--help` prints, and the reference of Python is made from the code. Notebooks are
run for their outputs; `CLUTTERGEN_RUN_NOTEBOOKS=0` shows their cells alone.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import html
import io
import json
import os
import posixpath
import re
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from cluttergen_jax.cli.main import COMMANDS, load, main

ROOT = Path(__file__).parents[1]
PAGES = (
    {
        "README.md": "index.md",
        "CONTRIBUTING.md": "contributing.md",
        "CHANGELOG.md": "changes.md",
        "studies/benchmarks/README.md": "benchmarks.md",
        "reports/README.md": "reports/index.md",
        "reports/results.md": "reports/results.md",
        "reports/measured.md": "reports/measured.md",
        "reports/missed.md": "reports/missed.md",
        "reports/benchmarks.md": "reports/benchmarks.md",
    }
    | {
        f"examples/{path.name}": f"tutorials/{path.stem}.md"
        for path in sorted((ROOT / "examples").glob("*.py"))
    }
    | {
        f"docs/notebooks/{path.name}": f"notebooks/{path.stem}.md"
        for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
    }
)
"""Files of the repository outside docs, and the pages that they become."""
BOOSTS = {
    "reference/python/": 0.01,
    "reports/": 0.1,
    "changes.md": 0.1,
    "benchmarks.md": 0.1,
    "contributing.md": 0.1,
    "reference/": 1.0,
}
"""By the beginning of a page's name, what its hits in the search are multiplied by; the first that fits."""
_OF_READERS = 100.0
"""The same of all other pages, which people read: a title counts 1000 times as much as a word of a text."""
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
_WIDE = "300"
"""Columns of a terminal in which an option of a command and its type are on one line."""
_PUBLIC = ("assets", "physics", "placement", "importing", "sensing", "learning", "scene", "rendering",
           "views", "generation", "judging", "evaluation", "downstream")  # fmt: skip
"""The packages whose modules are in the reference of Python."""


_CODE = re.compile(r"(?P<ticks>`+)(?!`).+?(?<!`)(?P=ticks)(?!`)", re.DOTALL)
_SPECIAL = re.compile(
    r"(?m:^[:!])|[\\`*{}#|]|(?<![^\W_])_|_(?![^\W_])|\](?=[(\[])|[<>]|&(?=#?\w+;)"
)
_ENTITIES = {"<": "&lt;", ">": "&gt;", "&": "&amp;", ":": "&#58;"}


def escaped(text: str) -> str:
    """Text as Markdown that shows each of its characters; code in backticks and indented code stay code."""
    blocks = re.split(r"(\n[ \t]*\n)", text)
    return "".join(block if _is_code(block) else _escaped_block(block) for block in blocks)


def _is_code(block: str) -> bool:
    return all(line.startswith("    ") or not line.strip() for line in block.split("\n"))


def _escaped_block(text: str) -> str:
    parts = []
    end = 0
    for code in _CODE.finditer(text):
        parts += [_SPECIAL.sub(_escape, text[end : code.start()]), code[0]]
        end = code.end()
    return "".join(parts) + _SPECIAL.sub(_escape, text[end:])


def _escape(found: re.Match[str]) -> str:
    return _ENTITIES.get(found[0], f"\\{found[0]}")


class EscapedDocstrings(griffe.Extension):
    """Shows docstrings in the reference of Python as they are written (`extensions` of mkdocstrings)."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Before the docstring is read: names of arguments have nothing to escape."""
        if obj.docstring is not None:
            obj.docstring.value = escaped(obj.docstring.value)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are made."""
    for source, uri in PAGES.items():
        if source.endswith(".ipynb"):
            _add_notebook(files, config, source, uri)
            continue
        text = (ROOT / source).read_text(encoding="utf-8")
        content = _tutorial(text, source) if source.endswith(".py") else text
        files.append(File.generated(config, uri, content=content))
    for picture in sorted((ROOT / "reports").rglob("*.png")):
        uri = str(picture.relative_to(ROOT))
        files.append(File.generated(config, uri, abs_src_path=str(picture)))
    files.append(File.generated(config, "reference/commands.md", content=_commands()))
    for name in _PUBLIC:
        files.append(
            File.generated(config, f"reference/python/{name}.md", content=_package_page(name))
        )
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links of the repository become links of the site; the package map is drawn."""
    uri = page.file.src_uri
    page.meta.setdefault("search", {"boost": boost_of(uri)})
    source = next((path for path, made in PAGES.items() if made == uri), f"docs/{uri}")

    def relinked(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[1]))
        inside = PAGES.get(target, target.removeprefix("docs/"))
        return posixpath.relpath(inside, posixpath.dirname(uri) or ".") + (match[2] or "")

    markdown = _LINK.sub(relinked, _without_code_links(markdown, source))
    if uri == "contributing.md":
        # On the site the drawing stands where the file has its list.
        markdown = re.sub(
            r"(?<=## Package layout\n\n)(?: {4}.+\n)+", _package_map() + "\n", markdown
        )
    return markdown


def boost_of(uri: str) -> float:
    """What hits of the search in a page are multiplied by: guides come before references and records."""
    return next((boost for start, boost in BOOSTS.items() if uri.startswith(start)), _OF_READERS)


def _without_code_links(markdown: str, source: str) -> str:
    """Links to files that are no page, such as modules, lose their target: the text names the file."""

    def without_target(match: re.Match[str]) -> str:
        target = posixpath.normpath(
            posixpath.join(posixpath.dirname(source), match[2].partition("#")[0])
        )
        is_page = target in PAGES or target.startswith("docs/")
        return match[0] if is_page else match[1]

    return re.sub(r"(?<!!)\[([^\]]*)\]\((?![a-z]+:|#)([^)\s]+)\)", without_target, markdown)


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


_SECONDS_PER_CELL = 1800


def run_notebook(path: Path) -> dict[str, Any]:
    """A notebook with the outputs of its cells, run in a folder and with user pools of its own.

    Raises:
      nbclient.exceptions.CellExecutionError: a cell failed; the message has its traceback.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        env = os.environ | {"CLUTTERGEN_HOME": str(Path(folder, "home"))}
        NotebookClient(
            notebook,
            timeout=_SECONDS_PER_CELL,
            kernel_name="python3",
            resources={"metadata": {"path": folder}},
        ).execute(env=env)
    return notebook


def _add_notebook(files: Files, config: MkDocsConfig, source: str, uri: str) -> None:
    """The page of a notebook, and the pictures that its cells show."""
    path = ROOT / source
    is_run = os.environ.get("CLUTTERGEN_RUN_NOTEBOOKS", "1") != "0"
    notebook = run_notebook(path) if is_run else json.loads(path.read_text(encoding="utf-8"))
    parts = []
    for number, cell in enumerate(notebook["cells"]):
        # A list of lines in the file, one text once it was read by nbformat.
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        for place, output in enumerate(cell["outputs"]):
            picture = output.get("data", {}).get("image/png")
            if picture is None:
                parts += _output_text(output)
                continue
            name = f"{path.stem}_{number}_{place}.png"
            content = base64.b64decode(picture)
            files.append(File.generated(config, f"notebooks/{name}", content=content))
            parts.append(f"![What the cell shows]({name})")
    # The page is a folder of the site, and the notebook lies beside it.
    parts.append(f'<a href="../{path.name}" download>Download this notebook</a>')
    files.append(File.generated(config, uri, content="\n\n".join(parts) + "\n"))


def _output_text(output: dict[str, Any]) -> Iterator[str]:
    """What a cell prints or shows that is no picture; progress bars (stderr) are left out."""
    data = output.get("data", {})
    if "text/html" in data:
        # One line: an empty one would end the block of HTML.
        yield " ".join(data["text/html"].split("\n"))
    elif text := data.get("text/plain") or (output.get("name") == "stdout" and output["text"]):
        yield f"```text\n{text.rstrip()}\n```"


def _commands() -> str:
    """What each command says of itself, with an anchor for each option."""
    os.environ["COLUMNS"] = _WIDE
    about = "What `cluttergen COMMAND --help` prints. Every option has an anchor, such as `#generate-pool`."
    parts = ["# Command line", about]
    for name, summary in COMMANDS.items():
        actions = _actions(name)
        parts += [f"## {name}", *([escaped(summary)] if actions else [])]
        for command in [f"{name} {action}" for action in actions] or [name]:
            parts += [f"### {command}"] if actions else []
            parts.append(_command(command, _help(command.split())))
    return "\n\n".join(parts) + "\n"


def _command(name: str, text: str) -> str:
    """A command's help in Markdown: usage, what it does, and its arguments."""
    intro, *boxes = re.split(r"\n *([a-z][a-z -]*)\n *-{10,} *\n", text)
    usage, _, about = intro.partition("\n\n")
    parts = [f"```text\n{usage.removeprefix('usage: ').strip()}\n```", escaped(about.strip())]
    place = 0
    for title, box in zip(boxes[::2], boxes[1::2], strict=True):
        options = []
        # What a group is for stands above a line.
        *purpose, listed = re.split(r"^ *-{10,} *$", box, maxsplit=1, flags=re.MULTILINE)
        # An argument begins its line after two spaces; what is said of it may go on below, further in.
        for entry in re.findall(r"^  \S.*(?:\n {3,}\S.*)*", listed, re.MULTILINE):
            place += 1
            written, *rest = re.split(r"(?<=\S) {2,}|\n", entry.strip(), maxsplit=1)
            flags = re.findall(r"(?<![\w-])--[a-z][\w-]*", written) or [f"--argument-{place}"]
            if rest and "--help" not in flags:
                anchor = f"{name} {flags[0][2:]}".replace(" ", "-")
                options.append(_option(anchor, written, " ".join(rest[0].split())))
        if options and title.strip().endswith(" options"):
            group = title.strip().removesuffix(" options").replace("-", " ")
            text = escaped(" ".join(" ".join(purpose).split()))
            parts.append(f"**{group.capitalize()}** {text}".rstrip())
        parts += options
    return "\n\n".join(parts)


def _option(anchor: str, written: str, text: str) -> str:
    """One argument: how it is written, its default, and what it does."""
    default = re.search(r"\((default: .*|required|optional)\)$", text)
    about = text[: default.start()].strip() if default else text
    usual = escaped(default[1]) if default else "optional"
    return f'<a id="{anchor}"></a>`{written}` ({usual})\n:   {escaped(about)}'


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


def _package_page(name: str) -> str:
    """The reference of a package: what its docstring says, and the public names of each of its modules."""
    folder = ROOT / "cluttergen_jax" / name
    parts = [f"# cluttergen_jax.{name}", escaped(_docstring(folder / "__init__.py"))]
    for path in sorted(folder.rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        names = _public_names(path)
        if not names or any(part.startswith("_") or part == "scripts" for part in path.parts[-4:]):
            continue
        parts.append(f"## {module}\n\n{escaped(_docstring(path))}")
        parts += [f"::: {module}.{each}" for each in names]
    return "\n\n".join(parts) + "\n"


def _public_names(path: Path) -> list[str]:
    """The functions and classes that a module defines for others."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    kinds = (ast.FunctionDef, ast.ClassDef)
    return [each.name for each in body if isinstance(each, kinds) and not each.name.startswith("_")]


def _docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


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
    first = _docstring(path).splitlines()[0]
    return f"<div><b>{name}</b><br>{html.escape(first.replace('`', ''))}</div>"
