"""When and on what machine figures were made: rows and findings that are kept keep it."""

import json

import pytest

from cluttergen_jax.evaluation.machine import machine, origins_of
from cluttergen_jax.evaluation.report import provenance
from cluttergen_jax.evaluation.runner import Runner
from cluttergen_jax.evaluation.running import run_study
from cluttergen_jax.evaluation.store import Store
from cluttergen_jax.evaluation.studies.study import Findings, Study, grid, row_of
from cluttergen_jax.evaluation.trial import Trial
from tests.helpers.records import unsigned

SMALL = Trial(num_objects=2, trials=6)
ELSEWHERE = {"date": "2001-01-01", "machine": {"cores": 64, "cpu": "another"}}


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return Runner(Store(tmp_path_factory.mktemp("results")))


def test_kept_rows_keep_the_day_and_the_machine_that_made_them(runner, tmp_path):
    trials = grid(SMALL, seed=(0, 1))
    study = Study("rows", "rows", 6, lambda scale: trials)

    def result():
        return run_study(Runner(runner.store), study, trials, tmp_path, "paper", "command", False)

    now = result()
    assert now["machine"] == machine()
    assert "also_made" not in now
    path = runner.store.path(trials[0].title, runner.resolve(trials[0]).key)
    stored = unsigned(json.loads(path.read_text()))
    path.write_text(json.dumps(stored | ELSEWHERE))
    mixed = result()
    assert (mixed["date"], mixed["machine"], mixed["also_made"]) == (now["date"], machine(), [ELSEWHERE])
    # An older version did not store them.
    path.write_text(json.dumps({name: stored[name] for name in stored if name not in ELSEWHERE}))
    older = result()
    assert older["also_made"] == [{"date": None, "machine": None}]
    assert "older version" in provenance(older)
    path.write_text(json.dumps(stored))


@pytest.mark.parametrize("keeps_each", [True, False])
def test_kept_findings_keep_them_too(runner, tmp_path, keeps_each):
    name = f"measured-{keeps_each}"

    def measure(runner, trials, stem):
        return Findings([row_of(SMALL, runner.measure(SMALL, name, dict) if keeps_each else {})])

    study = Study(name, "measured", 6, lambda scale: (SMALL,), measure=measure, keeps_each=keeps_each)

    def result():
        return run_study(Runner(runner.store), study, (SMALL,), tmp_path, "paper", "command", False)

    now = result()
    assert now["machine"] == machine()
    (path,) = runner.store.root.glob(f"*{name.lower()}*.json")
    path.write_text(json.dumps(unsigned(json.loads(path.read_text())) | ELSEWHERE))
    again = result()
    assert (again["date"], again["machine"]) == (ELSEWHERE["date"], ELSEWHERE["machine"])
    assert again["measure"] == now["measure"]


def test_machines_are_listed_with_their_days():
    here = {"date": "2002-02-02", "machine": {"cores": 2}}
    made = [ELSEWHERE, {}, here | {"date": "2002-02-04"}, here]
    assert origins_of(made) == [
        {"date": "2002-02-02 to 2002-02-04", "machine": {"cores": 2}},
        ELSEWHERE,
        {"date": None, "machine": None},
    ]
