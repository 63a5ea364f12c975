"""Where results go: a place that cannot be meant is refused before any work is done for it."""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.errors import ConfigError


def check_folder(out: str | Path | None, argument: str = "out") -> None:
    """Refuses what can be no folder on this machine: nothing, a URL, a file; None is let through.

    Raises:
      ConfigError: it names the argument.
    """
    if out is None:
        return
    path = Path(out)
    nearest = next((each for each in (path, *path.parents) if each.exists()), path)
    if not str(out) or "://" in str(out) or not nearest.is_dir():
        is_file = str(out) and nearest.is_file()
        raise ConfigError(
            f"{argument} = {str(out)!r}" + (f", where {nearest} is a file" if is_file else ""),
            "a folder on this machine, there or not",
            f"another `{argument}`",
        )


def check_file(out: str | Path | None, argument: str, example: str) -> None:
    """Refuses what can be no file on this machine: nothing, a URL, a folder; None is let through.

    Raises:
      ConfigError: it names the argument.
    """
    if out is None:
        return
    if not Path(out).name or "://" in str(out) or Path(out).is_dir():
        raise ConfigError(
            f"{argument} = {str(out)!r}", "a file on this machine, there or not", f"{argument}={example!r}"
        )
    check_folder(Path(out).parent, argument)
