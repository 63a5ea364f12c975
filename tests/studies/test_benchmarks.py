"""The benchmarks run at their smallest, and the README's sections are replaced as they should be."""

import pytest

from cluttergen_jax.assets.pool import Pool, write_pool
from studies.benchmarks import (
    contact,
    engines,
    gpu,
    last_check,
    library,
)
from studies.benchmarks.bodies import box


@pytest.fixture
def pool(tmp_path):
    objects = (box("brick", (0.03, 0.04, 0.05), 0.2), box("slab", (0.05, 0.05, 0.01), 0.3))
    return str(write_pool(tmp_path / "blocks", Pool("blocks", objects)))


@pytest.mark.slow
def test_contact_runs(pool):
    args = contact.Contact(
        pool=(pool,), trials=2, num_scenes=2, warp=False, only=("ours", "pyramidal")
    )
    outcomes = contact.measure({name: contact.candidates()[name] for name in args.only}, args)
    assert outcomes["ours"].solo[0].rate == 1.0
    assert "| pyramidal |" in contact.body_of(outcomes, args)


@pytest.mark.slow
def test_last_check_runs(pool):
    args = last_check.LastCheck(
        pool=pool, support=("table",), method=("clear",), num_scenes=4, num_verified=2
    )
    checks = last_check.measure(args)
    assert len(checks[0].full) == 4
    assert checks[0].is_verified.sum() == 2
    assert "| clear, table | 4 | 4 |" in last_check.body_of(checks, args)


@pytest.mark.slow
def test_engines_run(pool):
    args = engines.Engines(pool=pool, num_scenes=2, rounds=1, num_awake=1, num_replayed=0)
    contenders = engines.compete(args)
    assert contenders["native, 1 thread"].success == 1.0
    assert all(each.turns[0].attempts > 0 for each in contenders.values())
    assert "| native, 1 thread |" in engines.body_of(contenders, [], args)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("part", gpu.PARTS)
def test_every_part_about_a_gpu_runs_in_miniature(part, tmp_path):
    pytest.importorskip("warp", reason="needs the extra gpu")
    rows = gpu.measure(gpu.Gpu(parts=(part,), out=tmp_path, minutes=25.0, small=True))
    made = rows.parts[part]
    assert made
    assert not [row for row in made.values() if "failed" in row or "goes_on" in row]
    if part == "agreement":
        assert all(row["equal"] == row["attempts"] for row in made.values())
    if part == "scenes":
        assert {row["success"] for row in made.values()} == {1.0}
    assert part == "doctor" or f"### {part}" in gpu.body_of(rows)


@pytest.mark.slow
def test_library_runs(capsys):
    library.main(library.Library(sizes=(10, 260), num_scenes=2))
    out = capsys.readouterr().out
    assert "| 10 | all |" in out
    assert "| 260 | 64 |" in out
