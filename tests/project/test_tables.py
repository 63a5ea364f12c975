"""Tables of text, and the figures in them: intervals, spreads, and why one is missing."""

import csv
import io

import numpy as np
import pytest
from scipy.stats import norm

from cluttergen_jax.statistics import is_of_share, whole_shares, wilson
from cluttergen_jax.tables import Table


@pytest.mark.parametrize(("successes", "trials"), [(0, 8), (8, 8), (3, 7), (412, 1000)])
def test_intervals_hold_the_rates_that_wilsons_test_accepts(successes, trials):
    ends = wilson(successes, trials)
    for end in ends:
        if 1e-12 < end < 1 - 1e-12:
            # At an end of the interval the score test is at its limit.
            score = (successes / trials - end) / np.sqrt(end * (1 - end) / trials)
            assert abs(score) == pytest.approx(norm.ppf(0.975))
    assert 0 <= ends[0] <= successes / trials <= ends[1] <= 1


def test_whole_shares_are_within_one_however_they_grow():
    rng = np.random.default_rng(0)
    for _ in range(300):
        shares = rng.dirichlet(np.ones(rng.integers(2, 5)))
        counts = np.zeros(len(shares), int)
        for total in np.cumsum(rng.integers(1, 20, 5)).tolist():
            grown = whole_shares(total, shares, counts)
            assert grown.sum() == total
            assert (grown >= counts).all()
            assert np.abs(grown - total * shares).max() < 1
            counts = grown


def test_the_largest_remainders_are_rounded_up():
    assert whole_shares(7, (0.8, 0.1, 0.1)).tolist() == [5, 1, 1]
    assert whole_shares(10, (0.7, 0.3, 0.0)).tolist() == [7, 3, 0]


@pytest.mark.parametrize("share", [0.0, 1 / 3, 0.6, 1.0])
def test_any_number_of_items_has_its_share(share):
    for start in (0.0, 0.4, 0.99):
        found = np.cumsum([is_of_share(place, share, start) for place in range(200)])
        assert np.abs(found - share * np.arange(1, 201)).max() < 1 + 1e-9


def test_what_is_written_reads_back():
    table = Table("t", ("a", "b"), (("x|y", "1,5"), ("50 %", "-")), ("a note",))
    assert list(csv.reader(io.StringIO(table.csv()))) == [["a", "b"], ["x|y", "1,5"], ["50 %", "-"]]
    assert table.markdown().splitlines() == [
        "| a | b |",
        "|---|---|",
        r"| x\|y | 1,5 |",
        "| 50 % | - |",
        "",
        "- a note",
    ]
    assert r"50 \% & - \\" in table.latex()
