"""Notebooks: stored without outputs, begin with a cell for Colab, name what there is, and run."""

import ast
import base64
import json
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

import cluttergen_jax as cg
from tests.helpers.drawing import needs_gl

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))

# What must be read in the outputs of each.
EXPECTED = {
    "own_objects": r"tin: \d\.\d+ kg(.|\n)*4 free objects(.|\n)*of 8 scenes succeed",
    "training_loop": r"step 5: loss(.|\n)*after 200 steps(.|\n)*mean reward",
    "detector_data": r"train-00-000000(.|\n)*visible",
}


def code_cells(path):
    """The code of each cell, without commands of IPython."""
    cells = json.loads(path.read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    return [re.sub(r"^(\s*)%.*$", r"\1pass", text, flags=re.MULTILINE) for text in code]


def test_there_are_three():
    assert {path.stem for path in NOTEBOOKS} == set(EXPECTED)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs(path):
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_begins_with_a_cell_for_colab(path):
    first = next(
        cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"
    )
    text = "".join(first["source"])
    assert "%pip install" in text
    assert 'os.environ["MUJOCO_GL"] = "egl"' in text
    # Elsewhere it does nothing.
    assert 'if "google.colab" in sys.modules:' in text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_code_of_a_notebook_names_what_there_is(path):
    tree = ast.parse("\n".join(code_cells(path)))
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "cg"
    }
    assert used
    assert used <= set(cg.__all__)


def test_the_page_of_a_notebook_has_what_its_cells_show():
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    data = b"\x89PNG a picture"
    outputs = [
        {"output_type": "stream", "name": "stdout", "text": "printed\n"},
        {"output_type": "stream", "name": "stderr", "text": "a progress bar"},
        {"data": {"image/png": base64.b64encode(data).decode(), "text/plain": "<Image>"}},
        {"data": {"text/html": "<div>a\n\ntable</div>", "text/plain": "Bank(...)"}},
        {"data": {"text/plain": "'a value'"}},
    ]
    cells = [
        {"cell_type": "markdown", "source": ["# A title\n", "Words."]},
        {"cell_type": "code", "source": "run()", "outputs": outputs},
    ]
    hook = runpy.run_path(str(ROOT / "docs" / "site_pages.py"))
    add = hook["_add_notebook"]
    add.__globals__["run_notebook"] = lambda path: {"cells": cells}
    files = []
    config = SimpleNamespace(
        site_dir="site", use_directory_urls=True, plugins=SimpleNamespace(_current_plugin="test")
    )
    add(files, config, "docs/notebooks/own_objects.ipynb", "notebooks/own_objects.md")
    (picture, page) = files
    assert picture.content_bytes == data
    text = page.content_string
    assert text.startswith(
        "# A title\nWords.\n\n```python\nrun()\n```\n\n```text\nprinted\n```\n\n"
    )
    assert f"]({picture.src_uri.removeprefix('notebooks/')})" in text
    assert "\n\n<div>a  table</div>\n\n```text\n'a value'\n```" in text
    assert not {"progress", "<Image>", "Bank(...)"} & set(re.split(r"\s", text))


@needs_gl
@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_pictures(path):
    for module in ("mkdocs", "nbclient", "ipykernel"):
        pytest.importorskip(module, reason="needs the extra docs")
    hook = runpy.run_path(str(ROOT / "docs" / "site_pages.py"))
    notebook = hook["run_notebook"](path)
    outputs = [each for cell in notebook["cells"] for each in cell.get("outputs", ())]
    data = [each["data"] for each in outputs if "data" in each]
    printed = "".join(each["text"] for each in outputs if each.get("name") == "stdout")
    assert re.search(EXPECTED[path.stem], printed), printed
    assert any("image/png" in each for each in data)
    assert any("data:image/png" in each.get("text/html", "") for each in data)
