"""The suite `downstream` on the page of results: its result brings its tables along."""

import json
from dataclasses import asdict

import pytest

import cluttergen_jax as cg
from cluttergen_jax.downstream.placer.evaluation.evaluate import PlacerComparison
from cluttergen_jax.downstream.suite import SETS, result_of
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.evaluation.report import document, read_results, tables_of, write_report
from cluttergen_jax.tables import Table


def comparison(queries: int) -> PlacerComparison:
    """Two tables of one made-up row."""
    row = {"trial": {"placer": "random", "queries": queries}, "sources": {}, "figures": {}}
    tables = [
        Table(f"{queries} queries", ("placer", "stands"), (("random", "0.5"),), ("a note",)),
        Table("By", ("a",), ()),
    ]
    return PlacerComparison([row], tables)


def test_a_result_is_written_read_again_and_stands_on_the_page(tmp_path):
    result = result_of(
        [comparison(20), comparison(10)], "cluttergen evaluate --suite downstream", quick=False
    )
    write_report(result, tmp_path)
    (read,) = read_results(tmp_path)
    assert read == json.loads(json.dumps(result))
    # The first set is told in full, the second by its main table.
    assert [asdict(table) for table in tables_of(read)] == [
        asdict(table) for table in (*comparison(20).tables, comparison(10).tables[0])
    ]
    page = document([read])
    assert "## What scenes are good for" in page
    assert "### Stable placement from one camera's view" in page
    assert "| random | 0.5 |" in page
    assert "`cluttergen evaluate --suite downstream`, 10 or 20 trials a row" in page


def test_what_the_suite_does_not_know_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="`methods` with suite 'downstream'"):
        cg.evaluate_suite("downstream", methods=("drop",), out=tmp_path)
    with pytest.raises(ConfigError, match=r"only = 'placment'.*Did you mean 'placement'"):
        cg.evaluate_suite("downstream", only=("placment",), out=tmp_path)
    with pytest.raises(ConfigError, match=r"pools = 'garden'.*household"):
        cg.evaluate_suite("downstream", pools=("garden",), out=tmp_path)
    assert len({one.name for one in SETS}) == len(SETS)


@pytest.mark.slow
def test_the_quick_suite_is_made_in_one_go_and_kept(tmp_path):
    (first,) = cg.evaluate_suite("downstream", quick=True, out=tmp_path, only=("placement",))
    (again,) = cg.evaluate_suite("downstream", quick=True, out=tmp_path)
    assert first["records"] == again["records"]
    assert {row["trial"]["placer"] for row in first["records"]} == {"random", "geometry"}
    assert (tmp_path / "placement.md").is_file()
    assert (tmp_path / "placement-1.csv").is_file()
