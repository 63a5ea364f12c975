"""What a download or a clone leaves in place of a file: a pointer of Git LFS, or a page of HTML."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.errors import AssetError

_POINTER = b"version https://git-lfs.github.com/spec/"
_PAGES = (b"<!doctype html", b"<html")


def stand_in(path: Path) -> tuple[str, str] | None:
    """What lies in place of a file, and what to do about it; None if it is the file, or cannot be opened."""
    try:
        with path.open("rb") as file:
            head = file.read(512).removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    except OSError:
        return None
    if head.startswith(_POINTER):
        return "a pointer of Git LFS in place of the file", "`git lfs pull` in the repository that it is from"
    if head.startswith(_PAGES):
        return (
            "a page of HTML in place of the file",
            "fetching it again; a browser shows what the page says",
        )
    return None


def refuse_stand_in(path: Path) -> None:
    """Raises AssetError if something lies in place of the file."""
    if found := stand_in(path):
        raise AssetError(f"{path} is {found[0]}", hint=found[1])
