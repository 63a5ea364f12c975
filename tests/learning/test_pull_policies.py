"""Weights of ablations: not in the package, found in a checkout, pulled from a hub."""

import shutil
from pathlib import Path

import pytest

import cluttergen_jax as cg
from cluttergen_jax.assets.pool import embedded_root
from cluttergen_jax.cli.main import main
from cluttergen_jax.errors import BankError, PoolError
from cluttergen_jax.learning.policies import embedded
from cluttergen_jax.learning.policies.embedded import find_policy, list_policies

ABLATIONS = Path(__file__).parents[2] / "scenes" / "ablations"


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A folder as a hub, and a package without ablations in a fresh home."""
    monkeypatch.setenv("CLUTTERGEN_HOME", str(tmp_path / "home"))
    package = tmp_path / "package"
    shutil.copytree(embedded_root() / "checkpoints" / "guided", package / "checkpoints" / "guided")
    monkeypatch.setattr(embedded, "embedded_root", lambda: package)
    for name in ("dining-normal", "study-open_loop"):
        shutil.copytree(ABLATIONS / name, tmp_path / "hub" / "scenes" / "ablations" / name)
    return tmp_path / "hub"


def test_the_error_says_where_they_are(hub):
    with pytest.raises(PoolError, match="cluttergen pull scenes/ablations --hub CHECKOUT"):
        find_policy("normal", "dining")


def test_they_are_pulled_and_found(hub, capsys):
    assert main(["pull", "scenes/ablations", "--hub", str(hub)]) == 0
    assert "pulled     2 checkpoints: dining-normal, study-open_loop" in capsys.readouterr().out
    assert list(list_policies()) == ["dining-normal", "guided", "study-open_loop"]
    assert (find_policy("normal", "dining") / "weights.npz").read_bytes() == (
        ABLATIONS / "dining-normal" / "weights.npz"
    ).read_bytes()
    with pytest.raises(BankError, match="exists"):
        cg.pull_policies("scenes/ablations", hub=str(hub))
    assert cg.pull_policies("scenes/ablations", hub=str(hub), overwrite=True) == [
        "dining-normal",
        "study-open_loop",
    ]


def test_a_damaged_one_is_refused_and_nothing_is_kept(hub):
    weights = hub / "scenes" / "ablations" / "study-open_loop" / "weights.npz"
    data = bytearray(weights.read_bytes())
    data[len(data) // 2] ^= 1
    weights.write_bytes(data)
    with pytest.raises(PoolError, match="damaged"):
        cg.pull_policies("scenes/ablations", hub=str(hub))
    assert list(list_policies()) == ["guided"]
    with pytest.raises(BankError, match="no data set"):
        cg.pull_policies("scenes/others", hub=str(hub))


def test_options_of_banks_are_refused(hub, capsys):
    assert main(["pull", "scenes/ablations", "--hub", str(hub), "--out", "there"]) == 2
    assert "--out for a data set of policies" in capsys.readouterr().err
