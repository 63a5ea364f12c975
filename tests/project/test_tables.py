"""Tables of text, and the figures in them: intervals, spreads, and why one is missing."""

import csv
import io

import numpy as np
import pytest
from scipy.stats import norm

from cluttergen_jax.statistics import wilson
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
