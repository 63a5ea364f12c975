"""The method `settle` through the user's door: counted, judged and refused like every other one."""

import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.scene.bank import read_bank
from cluttergen_jax.scene.bank.table import COUNTED, count_column
from cluttergen_jax.types import Verdict


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    out = tmp_path_factory.mktemp("settle") / "bank"
    cg.generate(out, "dining", method="settle", num_objects=6, num_scenes=12, render=False)
    return read_bank(out)


def test_scenes_stand_and_every_attempt_is_counted(bank):
    rows = [row for table in bank.tables() for row in table.to_pylist()]
    assert len(rows) == 12
    assert sum(row["is_success"] for row in rows) >= 10
    for row in rows:
        counted = [row[count_column(each)] for each in COUNTED]
        assert sum(counted) == sum(row["attempts"])
        assert row[count_column(Verdict.STABLE)] == row["num_placed"]
        assert row["num_placed"] == 6 or not row["is_success"]


def test_equal_seeds_are_equal_scenes_with_any_threads(bank, tmp_path):
    cg.generate(
        tmp_path / "again",
        "dining",
        method="settle",
        num_objects=6,
        num_scenes=12,
        render=False,
        num_threads=1,
    )
    for one, two in zip(bank.tables(), read_bank(tmp_path / "again").tables(), strict=True):
        assert one["poses"].to_pylist() == two["poses"].to_pylist()


def test_it_is_compared_unasked_by_the_rules_of_the_others():
    found = cg.evaluate(pools=["dining"], num_objects=4, trials=4, methods=["settle", "clear"])
    assert [row["row"] for row in found.rows] == ["settle", "clear"]
    assert all(row["success"] > 0 for row in found.rows)


def test_a_support_margin_is_asked_of_it():
    spec = cg.SceneSpec(pool="dining", method="settle", num_objects=4)
    assert spec.with_rules("settle").min_margin == spec.with_rules("clear").min_margin > 0


@pytest.mark.parametrize(
    "asked",
    [{"keep_out": ("0.1,0,0.2,0.2",)}, {"ruin_after": 3}, {"robust": True}, {"engine": "warp"}],
)
def test_what_needs_one_object_after_another_is_refused(asked):
    with pytest.raises(ConfigError, match="which makes each scene at once"):
        cg.make_sampler("dining", method="settle", num_objects=4, **asked)


def test_a_scene_that_is_not_filled_keeps_what_was_placed():
    found = cg.evaluate(["settle"], ["dining"], ["table-0.22x0.30"], num_objects=10, trials=4)
    (row,) = found.rows
    assert row["filled"] < 1
    assert 1 < row["placed"] < 10
