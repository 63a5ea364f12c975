"""Tables of text, and the figures in them: intervals, spreads, and why one is missing."""

import csv
import io

import numpy as np
import pytest
from scipy.stats import norm

from cluttergen_jax.evaluation.cells import Column, request_columns, table_of
from cluttergen_jax.proportions import spread_of, wilson
from cluttergen_jax.tables import Table, aligned_table, markdown_table


@pytest.mark.parametrize(("successes", "trials"), [(0, 8), (8, 8), (3, 7), (412, 1000)])
def test_intervals_hold_the_rates_that_wilsons_test_accepts(successes, trials):
    ends = wilson(successes, trials)
    for end in ends:
        if 1e-12 < end < 1 - 1e-12:
            # At an end of the interval the score test is at its limit.
            score = (successes / trials - end) / np.sqrt(end * (1 - end) / trials)
            assert abs(score) == pytest.approx(norm.ppf(0.975))
    assert 0 <= ends[0] <= successes / trials <= ends[1] <= 1


def test_nothing_tried_says_nothing():
    assert wilson(0, 0) == (0.0, 1.0)
    assert spread_of(np.zeros(0))["mean"] is None


def test_tables_refuse_ragged_rows():
    with pytest.raises(ValueError, match="2 columns"):
        Table("t", ("a", "b"), (("1",),))


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


def test_columns_of_a_terminal_are_flush():
    lines = aligned_table(("name", "mass"), [("a", "0.25"), ("longer", "12")]).splitlines()
    assert lines == ["name    mass", "a       0.25", "longer    12"]
    assert len({len(line) for line in lines}) == 1


def test_cells_may_be_anything_with_a_text():
    assert markdown_table(("n",), [(1,), (None,)]).splitlines()[2:] == ["| 1 |", "| None |"]


def test_a_missing_row_keeps_what_it_asked_and_a_note_says_why():
    columns = (*request_columns("pool", num_objects="objects"), Column("a", str), Column("b", str))
    made = {"trial": {"pool": "dining", "num_objects": 3}}
    lacking = made | {"missing": "no policy", "hint": "train"}
    table = table_of("t", columns, [lacking, lacking, made | {"missing": "2 scenes"}], ["a note"])
    assert table.columns == ("pool", "objects", "a", "b")
    assert table.rows == (("dining", "3", "-", "-"),) * 3
    assert table.notes == ("a note", "no policy; try: train", "dining: 2 scenes")
