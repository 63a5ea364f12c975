"""The documentation: it has every public name and every page of its menu, and builds without a warning."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import cluttergen_jax as cg

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


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
