"""The wheel stands alone: built, installed in a fresh environment outside the checkout, and put to work."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MOST_MEGABYTES = 10


def run(*command, cwd) -> str:
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=elsewhere, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_wheel_generates_outside_the_checkout(tmp_path):
    run(sys.executable, "-m", "build", "--wheel", "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.stat().st_size < MOST_MEGABYTES * 1e6
    run(sys.executable, "-m", "venv", "fresh", cwd=tmp_path)
    python = tmp_path / "fresh" / "bin" / "python"
    constraints = ROOT / "constraints.txt"
    run(python, "-m", "pip", "install", "-q", "-c", constraints, wheel, cwd=tmp_path)
    where = run(python, "-c", "import cluttergen_jax; print(cluttergen_jax.__file__)", cwd=tmp_path)
    assert str(ROOT) not in where
    cluttergen = tmp_path / "fresh" / "bin" / "cluttergen"
    assert run(cluttergen, "--version", cwd=tmp_path).startswith("cluttergen_jax ")
    listed = run(cluttergen, "list", cwd=tmp_path)
    assert all(
        name in listed
        for name in ("dining", "study", "office", "kitchen", "household", "round_table")
    )
    run(
        cluttergen,
        "generate",
        "-n",
        "1",
        "--method",
        "clear",
        "--out",
        "bank",
        "--no-render",
        cwd=tmp_path,
    )
    assert "1 of 1 scenes stand" in run(cluttergen, "verify", "bank", cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_both_distributions_are_ready_to_be_published(tmp_path):
    run(sys.executable, "-m", "build", "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    (sdist,) = tmp_path.glob("*.tar.gz")
    run(sys.executable, "-m", "twine", "check", "--strict", wheel, sdist, cwd=tmp_path)
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    folders = ("checkpoints", "placers", "pools", "segmenters", "supports")
    names = ("cluttergen_jax", *(f"scenes/{name}" for name in folders))
    files = {path for name in names for path in (ROOT / name).rglob("*")}
    data = {
        path.relative_to(ROOT)
        for path in files
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert "cluttergen_jax/py.typed" in held
    # The folder `scenes` of a checkout is installed as `cluttergen_jax/data`.
    package = Path("cluttergen_jax")
    inside = (
        path if path.parts[0] == package.name else package / "data" / Path(*path.parts[1:])
        for path in data
    )
    assert {str(path) for path in inside} <= held
    assert not any("ablations" in name or "/ready/" in name for name in held)
    tops = {name.partition("/")[0] for name in held}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"cluttergen_jax"}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_source_distribution_carries_what_the_documents_speak_of(tmp_path):
    run(sys.executable, "-m", "build", "--sdist", "--outdir", tmp_path, ROOT, cwd=tmp_path)
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    for path in ROOT.iterdir():
        if path.suffix in (".md", ".cff", ".py"):
            assert path.name in held
    for folder, kind in (
        ("docs", "*"),
        ("examples", "*.py"),
        ("studies", "**/*.py"),
        ("tests", "*.py"),
    ):
        assert {
            str(path.relative_to(ROOT)) for path in (ROOT / folder).glob(kind) if path.is_file()
        } <= held
    # Records of measurements are of the repository alone.
    assert not [name for name in held if name.startswith(("reports/", "tests/reports/"))]
