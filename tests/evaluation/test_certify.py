"""Certificates: measured by hand where a hand can, kept in the bank, and taken up again."""

import pytest

from cluttergen_jax.cli.main import main
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.table import CERTIFICATE
from tests.helpers import banks


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    path = tmp_path_factory.mktemp("banks") / "bank"
    banks.two_scenes(path)
    assert main(["certify", str(path), "--seconds", "0.5"]) == 0
    return path


def test_numbers_are_those_of_the_mechanics(bank):
    table = read_bank(bank).table
    one, two, failed = (table.slice(row, 1).to_pylist()[0] for row in range(3))
    assert all(failed[name] is None for name in CERTIFICATE.names)
    # Two things on the table, neither on the other; -1 is the table.
    assert one["rests_on"] == [[0, -1], [1, -1]]
    assert two["rests_on"] == [[0, -1], [2, -1]]
    for scene in (one, two):
        assert scene["detectors"] == ["native", "libccd"]
        assert scene["horizon_seconds"] == 0.5
        assert scene["num_contacts"] > 0
        assert 0 <= scene["residual_speed"] < 0.005
        assert 0 <= scene["horizon_drift"] < 1e-3
        assert 0 <= scene["penetration"] < 1e-3
        assert scene["shake"] == min(scene["shake_x"], scene["shake_y"])
    # Half of the narrower side of each, on the table.
    assert one["margins"] == pytest.approx([0.03, one["margins"][1]], abs=1e-4)
    assert two["margins"] == pytest.approx([0.03, 0.01], abs=1e-4)
    assert one["margin"] == min(one["margins"])
    # The tall one's centre is at ten times its half side: it tips over from 5.7 degrees on.
    assert [two[f"tilt_{by}"] for by in (1, 2, 5)] == [1.0, 1.0, 1.0]
    # Friction holds until 0.5 g; the tall one tips over at 0.1 g. What is let go takes a while for 5 mm.
    assert 0.5 * 9.81 - 0.05 < one["shake"] < 0.5 * 9.81 + 0.6
    assert 0.1 * 9.81 - 0.05 < two["shake"] < 0.1 * 9.81 + 0.6


def test_another_horizon_is_measured_anew_and_the_same_one_is_not(tmp_path, capsys):
    path = tmp_path / "bank"
    banks.two_scenes(path)
    for seconds, number in (("0.3", 3), ("0.3", 0), ("0.2", 3)):
        assert main(["certify", str(path), "--seconds", seconds]) == 0
        assert f"{number} rows are new" in capsys.readouterr().out
    horizons = [row["horizon_seconds"] for row in read_bank(path).table.to_pylist()]
    assert horizons == [pytest.approx(0.2), pytest.approx(0.2), None]
