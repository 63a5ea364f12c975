"""Files and folders are whole, old or new, whatever goes wrong while they are written."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

from cluttergen_jax import files
from cluttergen_jax.errors import BankError
from cluttergen_jax.kept_folder import KeptFolder, check_recipe


def write_folder(folder, text, **how):
    with files.folder_whole(folder, **how) as fresh:
        fresh.mkdir()
        (fresh / "text").write_text(text)


def write_until(moment, error):
    """Begins to write in the block of `moment`, a context that gives a path, and fails."""
    with moment as fresh:
        if fresh.suffix:
            fresh.write_bytes(b"ne")
        else:
            fresh.mkdir()
        raise error


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_a_file_is_what_was_written_with_the_usual_rights(tmp_path):
    path = tmp_path / "far" / "away.mp4"
    plain = tmp_path / "plain"
    files.write_atomically(path, b"old", is_durable=True)
    with files.file_whole(path) as fresh:
        assert fresh.suffix == ".mp4"
        fresh.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    plain.write_bytes(b"")
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode == plain.stat().st_mode
    assert names(path.parent) == {"away.mp4"}


def test_a_file_that_fails_leaves_the_old_one(tmp_path):
    path = tmp_path / "file.txt"
    files.write_atomically(path, b"old")
    with pytest.raises(TypeError):
        files.write_atomically(path, "text")
    with pytest.raises(KeyboardInterrupt):
        write_until(files.file_whole(path), KeyboardInterrupt())
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == {"file.txt"}


@pytest.mark.parametrize("is_only_writer", [False, True])
def test_a_folder_is_replaced_as_a_whole(tmp_path, is_only_writer):
    folder = tmp_path / "deep" / "folder"
    write_folder(folder, "old", is_only_writer=is_only_writer)
    (folder / "more").write_text("of the old")
    write_folder(folder, "new", is_only_writer=is_only_writer)
    assert names(folder) == {"text"}
    assert (folder / "text").read_text() == "new"
    assert names(folder.parent) == {"folder"}
    plain = tmp_path / "plain"
    plain.mkdir()
    assert folder.stat().st_mode == plain.stat().st_mode


@pytest.mark.parametrize("is_only_writer", [False, True])
def test_a_folder_that_fails_leaves_the_old_one(tmp_path, is_only_writer):
    folder = tmp_path / "folder"
    write_folder(folder, "old")
    with pytest.raises(OSError, match="full"):
        write_until(files.folder_whole(folder, is_only_writer), OSError("the disk is full"))
    # Nothing was made at all.
    with pytest.raises(FileNotFoundError), files.folder_whole(folder, is_only_writer):
        pass
    assert (folder / "text").read_text() == "old"
    assert names(tmp_path) == {"folder"}


def left_by(code):
    """Runs code in another process, which ends in the middle of it as a killed one does."""
    code = f"import os\nfrom pathlib import Path\nfrom cluttergen_jax import files\n{code}"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_a_writer_stopped_between_old_and_new_is_mended(tmp_path):
    folder = tmp_path / "folder"
    write_folder(folder, "old", is_only_writer=True)
    left_by(f"""
folder, rename = Path({str(folder)!r}), os.rename
os.rename = lambda a, b: os._exit(0) if b == folder else rename(a, b)
with files.folder_whole(folder, is_only_writer=True) as fresh:
    fresh.mkdir()
""")
    assert not folder.exists()
    files.put_back(folder)
    assert (folder / "text").read_text() == "old"
    files.put_back(folder)
    write_folder(folder, "newer", is_only_writer=True)
    assert (folder / "text").read_text() == "newer"
    assert names(tmp_path) == {"folder"}


def test_what_a_killed_writer_left_goes_and_what_is_being_written_stays(tmp_path):
    left_by(f"""
with files.file_whole(Path({str(tmp_path)!r}) / "film.mp4") as fresh:
    fresh.write_bytes(b"half")
    os._exit(0)
""")
    (left,) = names(tmp_path)
    with files.file_whole(tmp_path / "other.mp4") as fresh:
        fresh.write_bytes(b"new")
        # What one process of another machine has under way looks like this.
        elsewhere = tmp_path / left.replace(f".{files._machine()}-", ".00000000-")
        elsewhere.mkdir()
        files._remove_left.cache_clear()
        files.write_atomically(tmp_path / "third", b"")
    assert names(tmp_path) == {"other.mp4", "third", elsewhere.name}
    # Who alone writes there removes that, too, and what older versions left.
    (tmp_path / ".bank.json.partial").write_text("{")
    (tmp_path / ".sheet.png.123.partial.png").write_text("")
    files.remove_partial(tmp_path)
    assert names(tmp_path) == {"other.mp4", "third"}


@pytest.mark.parametrize(
    "name", ["file", "n" * 250, "\xe9" * 120, ".partial", "old", "a.b.partial"]
)
def test_any_name_can_be_written(tmp_path, name):
    files.write_atomically(tmp_path / name, b"")
    assert names(tmp_path) == {name}
    (tmp_path / name).unlink()
    for text in ("old", "new"):
        write_folder(tmp_path / name, text)
        assert names(tmp_path) == {name}
        assert (tmp_path / name / "text").read_text() == text


def test_links_laid_at_temporary_names_lead_nowhere(tmp_path):
    precious = tmp_path / "precious"
    place = tmp_path / "place"
    precious.mkdir()
    place.mkdir()
    (precious / "letter").write_text("mine")
    write_folder(place / "folder", "old")
    tag = f"{files._machine()}-{2**22 + 1}-00000000"
    for name in ("folder", "file"):
        for ending in (
            ".partial",
            ".old",
            ".removed",
            f".{tag}.partial",
            f".{tag}.begun",
            f".{tag}.old",
        ):
            (place / f".{name}{ending}").symlink_to(precious)
    # A folder in which a link lies, as one that an archive brings.
    (place / f".folder.{tag[:-1]}1.begun").mkdir()
    (place / f".folder.{tag[:-1]}1.begun" / "folder").symlink_to(precious)
    files.put_back(place / "gone")
    files.write_atomically(place / "file", b"")
    for is_only_writer in (False, True):
        write_folder(place / "folder", "new", is_only_writer=is_only_writer)
    with files.resumable_folder(place / "folder") as scratch:
        assert names(scratch) == set()
    files.remove_partial(place)
    files.remove(place / ".file.old")
    assert not (place / ".file.old").is_symlink()
    assert names(precious) == {"letter"}
    assert (precious / "letter").read_text() == "mine"
    assert (place / "folder" / "text").read_text() == "new"


def test_what_was_begun_is_gone_on_with_by_one(tmp_path):
    def begin(text):
        with suppress(KeyboardInterrupt), files.resumable_folder(tmp_path / "bank") as scratch:
            (scratch / "half").write_text(text)
            raise KeyboardInterrupt

    begin("1")
    files._remove_left.cache_clear()
    files.write_atomically(tmp_path / "other", b"")
    with (
        files.resumable_folder(tmp_path / "bank") as scratch,
        files.resumable_folder(tmp_path / "bank") as second,
    ):
        assert (scratch / "half").read_text() == "1"
        assert names(second) == set()
    assert names(tmp_path) == {"other"}


def test_many_write_the_same_at_once(tmp_path):
    written = [f"{number}" * 1000 for number in range(8)]

    def write(text):
        for _ in range(20):
            files.write_atomically(tmp_path / "file", text.encode())
            write_folder(tmp_path / "folder", text)

    with ThreadPoolExecutor(len(written)) as pool:
        list(pool.map(write, written))
    assert (tmp_path / "file").read_text() in written
    assert (tmp_path / "folder" / "text").read_text() in written
    assert names(tmp_path) == {"file", "folder"}


def test_a_kept_folder_is_continued_by_the_same_recipe_alone(tmp_path):
    recipe = {"seed": 1, "rules": {"margin": 0.0, "sides": (1, 2)}}
    written = json.loads(json.dumps(recipe))
    check_recipe(tmp_path, "a bank made", recipe, written)
    other = {"seed": 2, "rules": {"margin": 0.1, "sides": [1, 2]}}
    said = r"with another rules\.margin \(0\.0 there, 0\.1 asked for\), seed \(1 there, 2 asked for\)\."
    with pytest.raises(BankError, match=said + ".*another `out`"):
        check_recipe(tmp_path, "a bank made", other, written)
    folder = KeptFolder(
        tmp_path / "kept",
        lambda path: (path / "index").exists(),
        "{other} is in {path}",
        Path.is_dir,
    )
    with folder.lock(), pytest.raises(BankError, match=f"written by process {os.getpid()}"):
        folder.lock()
    (folder.path / "begun").mkdir()
    folder.check_place()
    (folder.path / "other").touch()
    with pytest.raises(BankError, match="other is in"):
        folder.lock()
    (folder.path / "index").touch()
    folder.lock().release()
