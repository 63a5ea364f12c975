"""The judge's scores of sense, against scenes that were put together by hand."""

import pytest

import cluttergen_jax as cg
from cluttergen_jax.cli.main import main
from cluttergen_jax.judging.sense import SenseFindings

_TABLE = '<geom type="box" size=".5 .5 .1" pos="0 0 .1" euler="0 0 {table}"/>'
_BODY = (
    '<body name="{name}" pos="{x} {y} {z}" euler="0 0 {turn}"><freejoint/>'
    '<geom type="box" size="{size}"/></body>'
)


def scene(path, table, *bodies):
    """A file of boxes on a table turned by so many degrees: name, x, y, bottom, turn, half sides."""
    parts = [_TABLE.format(table=table)]
    for name, x, y, bottom, turn, size in bodies:
        z = 0.2 + bottom + size[2]
        text = " ".join(map(str, size))
        parts.append(_BODY.format(name=name, x=x, y=y, z=z, turn=turn, size=text))
    path.write_text(f"<mujoco><worldbody>{''.join(parts)}</worldbody></mujoco>")
    return path


FLAT = (0.1, 0.08, 0.01)
SMALL = (0.03, 0.02, 0.01)


@pytest.fixture
def busy(tmp_path):
    """A fork on a plate, a mug on scissors, something unknown on a book, and a spoon far away."""
    return scene(
        tmp_path / "busy.xml",
        30,
        ("dinner_plate", -0.2, 0.0, 0.0, 30, FLAT),
        ("fork_2", -0.2, 0.0, 0.02, 60, SMALL),
        ("Scissors", 0.2, 0.0, 0.0, 34, FLAT),
        ("mug", 0.2, 0.0, 0.02, 70, SMALL),
        ("book", 0.0, 0.3, 0.0, 0, FLAT),
        ("object_17", 0.0, 0.3, 0.02, 0, SMALL),
        ("spoon", 0.3, -0.3, 0.0, 15, SMALL),
    )


def judged(path, **options):
    return cg.judge(path, seconds=(0.1,), detectors=("native",), **options)


def test_pairs_edges_and_groups_are_counted(busy):
    found = judged(busy, sense=True).sense
    assert found.usual == (("fork_2", "dinner_plate"),)
    assert found.unusual == (("mug", "Scissors"),)
    assert found.unknown == (("object_17", "book"),)
    assert found.usual_pairs == 0.5
    # Against the table's own edges, at 30 degrees: the plate and, to 4 degrees, the scissors.
    assert (found.num_boxes, found.num_along) == (7, 2)
    assert found.free == ("object_17",)
    # Plate and fork are near each other; the plate is far from the spoon and the mug.
    assert (found.num_paired, found.num_near) == (4, 2)


def test_a_tables_edges_count_and_not_the_worlds(tmp_path):
    along = scene(tmp_path / "a.xml", 30, ("book", 0, 0, 0, 33, FLAT))
    across = scene(tmp_path / "b.xml", 30, ("book", 0, 0, 0, 0, FLAT))
    assert judged(along, sense=True).sense.along_edges == 1.0
    assert judged(across, sense=True).sense.along_edges == 0.0


def test_rows_say_it_where_it_is_asked(busy):
    rows = {row["body"]: row for row in judged(busy, sense=True).rows.to_pylist()}
    assert (rows["fork_2"]["kind"], rows["fork_2"]["carried_by"]) == ("cutlery", "dinner_plate")
    assert rows["fork_2"]["is_usual"] is True
    assert rows["mug"]["is_usual"] is False
    assert rows["object_17"]["is_usual"] is None
    plain = judged(busy)
    assert plain.sense is None
    assert "kind" not in plain.rows.schema.names


def test_a_table_of_ones_own_decides(busy, tmp_path):
    table = tmp_path / "mine.yaml"
    table.write_text(
        "format: 1\nkinds:\n  mug: {words: [mug], on_top_of: [cutter]}\n  cutter: {words: [scissors]}\n"
    )
    found = judged(busy, sense=table).sense
    assert found.usual == (("mug", "Scissors"),)
    assert not found.unusual


def test_the_command_prints_it(busy, capsys):
    assert main(["judge", str(busy), "--sense", "--seconds", "0.1"]) == 0
    said = capsys.readouterr().out
    assert "usual pairs 0.500 of 2 in which one thing carries another" in said
    assert "unusual     mug on Scissors" in said


def test_totals_are_sums():
    one = SenseFindings(usual=(("a", "b"),), num_boxes=2, num_along=1)
    other = SenseFindings(unusual=(("c", "d"),), num_boxes=2, num_along=2)
    total = SenseFindings.total([one, other])
    assert total.usual_pairs == 0.5
    assert total.along_edges == 0.75
    assert SenseFindings().usual_pairs is None
