"""Files and folders are whole, old or new, whatever goes wrong while they are written."""

import errno
import os

import pytest

from cluttergen_jax import files


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
    path, plain = tmp_path / "far" / "away.mp4", tmp_path / "plain"
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


def test_a_full_disk_names_what_could_not_be_written(tmp_path):
    def full(moment, *name):
        with pytest.raises(OSError, match="No space") as caught:
            write_until(moment, OSError(errno.ENOSPC, "No space left on device", *name))
        return caught.value.filename

    assert full(files.file_whole(tmp_path / "film.mp4")) == str(tmp_path / "film.mp4")
    assert full(files.folder_whole(tmp_path / "export")) == str(tmp_path / "export")
    assert full(files.folder_whole(tmp_path / "export"), "elsewhere") == "elsewhere"
    assert names(tmp_path) == set()


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


def test_a_writer_stopped_between_old_and_new_is_mended(tmp_path, monkeypatch):
    folder = tmp_path / "folder"
    write_folder(folder, "old", is_only_writer=True)
    with monkeypatch.context() as stopped:
        stopped.setattr(files, "put_back", lambda folder: None)
        stopped.setattr(files.shutil, "rmtree", lambda *_, **__: None)
        rename = os.rename
        stopped.setattr(os, "rename", lambda a, b: 1 / 0 if b == folder else rename(a, b))
        with pytest.raises(ZeroDivisionError):
            write_folder(folder, "new", is_only_writer=True)
    assert not folder.exists()
    files.put_back(folder)
    assert (folder / "text").read_text() == "old"
    files.put_back(folder)
    write_folder(folder, "newer", is_only_writer=True)
    assert (folder / "text").read_text() == "newer"
    assert names(tmp_path) == {"folder"}
