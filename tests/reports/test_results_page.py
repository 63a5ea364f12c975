"""The page of results and the records that it is made of; no part of the source distribution."""

from pathlib import Path

import pytest

from cluttergen_jax.errors import ConfigError
from studies import make_results
from studies.methods import table1
from studies.pages import PAGES, write_pages
from studies.report import (
    document,
    provenance,
    read_results,
    tables_of,
    with_earlier_rows,
)
from studies.study import Scale
from studies.suites import STUDIES

REPORTS = Path(__file__).parents[2] / "reports"


def test_results_page_agrees_with_its_json():
    results = read_results(REPORTS / "results")
    notes = (REPORTS / "missed.md").read_text(encoding="utf-8")
    # New studies have no result until they are made.
    assert {result["name"] for result in results} <= set(STUDIES)
    assert (REPORTS / "results.md").read_text(encoding="utf-8") == document(results, notes)


def test_tables_of_the_readmes_agree_with_their_json(tmp_path):
    results = read_results(REPORTS / "results")
    for page in PAGES:
        text = (REPORTS.parent / page).read_text(encoding="utf-8")
        (tmp_path / page).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / page).write_text(text, encoding="utf-8")
    write_pages(results, tmp_path)
    for page in PAGES:
        written = (tmp_path / page).read_text(encoding="utf-8")
        assert (REPORTS.parent / page).read_text(encoding="utf-8") == written


def test_rows_of_episodes_come_with_what_a_suite_made(tmp_path, monkeypatch):
    monkeypatch.setattr(make_results, "FOLDER", tmp_path / "results")
    rows = tmp_path / "made" / "episodes" / "rearrange-3-true" / "paper" / "episodes.jsonl"
    (rows.parent / "films").mkdir(parents=True)
    (rows.parent / "films" / "success.gif").write_bytes(b"film")
    rows.write_bytes(b"{}\n")
    make_results.take_over(tmp_path / "made", keep_rows=False)
    taken = [each for each in (tmp_path / "results").rglob("*") if each.is_file()]
    assert [each.relative_to(tmp_path / "results") for each in taken] == [
        rows.relative_to(tmp_path / "made")
    ]
    assert taken[0].read_bytes() == rows.read_bytes()


def test_seeds_that_were_trained_in_another_way_have_a_row_of_their_own():
    (result,) = (each for each in read_results(REPORTS / "results") if each["name"] == "table1")
    one = next(
        row
        for row in result["records"]
        if row["trial"]["method"] == "beta_free" and "figures" in row
    )
    alike = one | {"trial": one["trial"] | {"training_seed": 1}}
    other = one | {"policy": one["policy"] | {"attempts": 1000}}
    missing = {"trial": one["trial"], "missing": "no checkpoint", "hint": "train it"}
    (table,) = table1.tables(result | {"records": [one, other, alike, missing]})
    assert [row[2] for row in table.rows] == ["2", "1"]
    # Scenes of several trainings are not as many trials of the method: a note says what the interval is of.
    assert any("success of several seeds" in note for note in table.notes)
    (table,) = table1.tables(result | {"records": [one, other]})
    assert not any("success of several seeds" in note for note in table.notes)
    (table,) = table1.tables(result | {"records": [missing]})
    assert len(table.rows) == 1


def test_rows_that_were_not_made_again_stay_with_where_they_come_from():
    (earlier,) = (each for each in read_results(REPORTS / "results") if each["name"] == "table1")
    asked = {trial.method for trial in table1.trials(Scale())}
    first, *others = (
        row for row in earlier["records"] if "figures" in row and row["trial"]["method"] in asked
    )
    of_before = first | {"trial": first["trial"] | {"method": "ranked"}}
    earlier = earlier | {"records": [first, of_before, *others]}
    # As an older version wrote it, which knew of no other order.
    first = first | {
        "trial": {name: value for name, value in first["trial"].items() if name != "order"}
    }
    earlier = earlier | {"records": [first, *earlier["records"][1:]]}
    again = first | {
        "trial": first["trial"] | {"order": "random"},
        "figures": first["figures"] | {"success": 0.5},
    }
    fresh = first | {"trial": again["trial"] | {"method": "guided"}}
    made = earlier | {
        "records": [again, fresh],
        "command": "cluttergen again",
        "date": "2026-12-01",
    }
    made.pop("earlier", None)
    merged = with_earlier_rows(made, earlier)
    assert len(merged["records"]) == len(others) + 2
    assert sum(row["figures"]["success"] == 0.5 for row in merged["records"]) == 1
    pools = [row["trial"]["pool"] for row in merged["records"]]
    assert pools == sorted(pools, key=pools.index), "the rows of a pool stand together"
    told = provenance(merged)
    assert told.startswith("`cluttergen again`")
    assert f"did not make again: `{earlier['command']}`" in told
    assert tables_of(merged)
    assert with_earlier_rows(earlier, made | {"records": [first]}) is earlier
    # What the older version did not know of sets new rows apart.
    largest = again | {"trial": again["trial"] | {"order": "largest"}}
    merged = with_earlier_rows(
        made | {"records": [again, largest]}, earlier | {"records": [first, *others]}
    )
    assert len(merged["records"]) == len(others) + 2
    imported = next(
        each for each in read_results(REPORTS / "results") if each["name"] == "imported"
    )
    last = imported | {"records": [imported["records"][-1] | {"figures": again["figures"]}]}
    assert len(with_earlier_rows(last, imported)["records"]) == len(imported["records"])
    robot = next(each for each in read_results(REPORTS / "results") if each["name"] == "robot")
    with pytest.raises(ConfigError, match="'robot' to be kept"):
        with_earlier_rows(robot, robot)
