"""Studies about fullness: rules of rows, rungs by fill, unseen objects, and who is as good as `guided`."""

import pytest

from cluttergen_jax.evaluation.trial import Trial
from cluttergen_jax.placement.config import MIN_MARGIN
from cluttergen_jax.statistics import wilson
from studies.rules import named_rows
from studies.study import Scale
from studies.suites import STUDIES, find_suite

SMALL = Trial.of(num_objects=2, trials=4)
NAMES = (
    "drop",
    "drop, ruin",
    "spread",
    "spread, random order",
    "guided",
    "guided, robust",
    "drop, ruin, robust",
)
PAPERS = ("table1", "table2", "fig1a", "steps_by_attempt", "attempts", "acceptance", "closed_loop")


@pytest.mark.parametrize("name", NAMES)
def test_rows_are_called_what_they_were_asked_as(name):
    (trial,) = named_rows([SMALL], name)
    assert trial.row_name == name
    assert trial.spec.min_margin == MIN_MARGIN


@pytest.mark.parametrize("name", PAPERS)
def test_tables_of_the_paper_keep_its_rules(name):
    for trial in STUDIES[name].trials(Scale()):
        assert (
            trial.spec.order,
            trial.spec.ruin_after,
            trial.spec.min_margin,
            trial.spec.budget,
        ) == (
            "random",
            0,
            0.0,
            None,
        )


def rows_of(**successes):
    """Rows of a hundred scenes with so many successes, by name of row."""
    found = []
    for name, good in successes.items():
        (trial,) = named_rows([SMALL], name.replace("_", ", "))
        low, high = wilson(good, 100)
        figures = {
            "trials": 100,
            "num_success": good,
            "success": good / 100,
            "low95": low,
            "high95": high,
            "attempts_per_valid_scene": 1000 / good,
            "simulated_steps_per_valid_scene": 2000 / good,
        }
        found.append({"trial": trial.fields(), "figures": figures})
    return found


def test_what_was_asked_of_the_dial_stands_beside_what_was_got():
    (planned,) = find_suite("extended", Scale(), ("dial",))
    rows = []
    for trial in planned.trials:
        (row,) = rows_of(spread=100)
        figures = row["figures"] | {"stack": {"mean": 1.5, "std": 0.5}}
        rows.append({"trial": trial.fields(), "figures": figures})
    result = {"name": "dial", "title": "t", "records": rows}
    (table,) = planned.study.tables(result)
    of_guided = [row for row in table.rows if row[1] == "guided"]
    asked, error = (table.columns.index(name) for name in ("objects on others, asked", "error"))
    assert [row[asked] for row in of_guided] == ["nothing", "0", "1", "2", "3", "4", "5"]
    # By hand: 1.5 for 1, 2 and 3; of nothing and of 0 there is no share.
    assert [row[error] for row in of_guided][:5] == ["-", "-", "+50%", "-25%", "-50%"]
    assert all(trial.spec.order == "weighted" for trial in planned.trials)
