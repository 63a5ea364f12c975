"""Comparing methods from the command line."""

import json

from cluttergen_jax.cli.main import load, run

SUPPORTS = ("table", "round_table")


def command(tmp_path, **options):
    return run(load("evaluate")(trials=4, out=str(tmp_path), num_objects=2, **options))


def test_command_takes_up_what_was_made_before(tmp_path, capsys):
    assert command(tmp_path, methods=("random",), supports=SUPPORTS[:1]) == 0
    (first,) = json.loads((tmp_path / "results.json").read_text())
    capsys.readouterr()
    assert command(tmp_path, methods=("random",), supports=SUPPORTS) == 0
    rows = json.loads((tmp_path / "results.json").read_text())
    assert [row["support"] for row in rows] == list(SUPPORTS)
    # Its times would be others if it had been made again.
    assert rows[0] == first
    assert {path.suffix for path in tmp_path.iterdir() if path.is_file()} == {
        *(".md", ".csv", ".tex", ".json", ".png"),
    }
    shown, said = capsys.readouterr()
    assert shown.startswith("| pool | support | objects | method | success [95 %] |")
    assert "2 rows, 1 kept from before, 1 to be made\n" in said
    assert "[2 of 2 rows, " in said
    # A row that cannot be made is told below the table and by the status.
    assert (
        command(
            tmp_path, methods=("random", "policy"), supports=SUPPORTS[:1], checkpoints=str(tmp_path)
        )
        == 1
    )
    shown, said = capsys.readouterr()
    assert (
        "| policy | - | - | - | - | - | - | - |\n\n"
        "- no checkpoint for method 'policy' on pool 'dining'; try: " in shown
    )
    assert "error: 1 row could not be made; why stands below the table" in said
    assert json.loads((tmp_path / "results.json").read_text())[0] == first
