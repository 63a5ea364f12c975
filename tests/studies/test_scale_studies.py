"""Studies of scale: banks that are multiplied, and what is derived from small runs."""

import numpy as np
import pytest

from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.scene.bank import read_bank, stats_of
from studies.benchmarks.big_bank import Sample
from studies.benchmarks.million_rows import multiply
from studies.benchmarks.plan import Plan, Rates, rates_of
from tests.helpers import banks


def test_a_multiplied_bank_has_the_rows_again_and_no_scene_twice(tmp_path):
    banks.write(tmp_path / "real")
    real = read_bank(tmp_path / "real")
    number = 3 * BLOCK_SIZE + 10
    multiply(real, tmp_path / "many", number)
    many = read_bank(tmp_path / "many")
    assert many.table["index"].to_pylist() == list(range(number))
    first = many.table.slice(0, 2 * BLOCK_SIZE)
    assert first.equals(real.table.select(first.schema.names))
    again = many.table.slice(2 * BLOCK_SIZE)
    theirs = real.table.slice(0, again.num_rows)
    assert again["objects"].to_pylist() == theirs["objects"].to_pylist()
    one, other = (np.array(rows["poses"].to_pylist(), np.float32) for rows in (again, theirs))
    np.testing.assert_array_equal(one[..., 1:], other[..., 1:])
    np.testing.assert_allclose(one[..., 0], other[..., 0], rtol=1e-6)
    stats = stats_of(many)
    assert stats.scenes == number
    assert not stats.duplicates


def test_rates_leave_out_the_start_and_the_end():
    def sample(seconds, scenes, driver, workers):
        return Sample(seconds, scenes, 0.0, 0.0, driver, workers)

    samples = [
        sample(0, 0, 0, 0),
        sample(30, 100, 5, 20),
        sample(40, 300, 6, 40),
        sample(50, 500, 7, 60),
        sample(58, 500, 8, 61),
        sample(60, 600, 9, 0),
    ]
    rates = rates_of(samples)
    assert rates == Rates(a_second=20, a_core_second=10, driver=0.005)
    with pytest.raises(SystemExit, match="make more scenes"):
        rates_of(samples[:2])


def test_workers_beyond_what_one_command_writes_for_make_nothing_faster():
    rates = Rates(a_second=10, a_core_second=10, driver=0.001)
    rows = [Plan().derive(number, rates) for number in (1, 50, 100, 200)]
    assert [row[2] for row in rows] == ["27.78", "0.56", "0.28", "0.28"]
    assert [row[1] for row in rows] == ["27.8", "27.8", "27.8", "55.6"]
    assert rows[-1][-1] == "100.0%"
