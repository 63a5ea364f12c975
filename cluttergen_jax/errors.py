"""Errors: each says what was given, what is allowed, and what to try."""

import difflib
from collections.abc import Iterable, Sequence

_LONGEST = 2000
"""Letters of a message's first part."""
_LIKE = 0.65
"""Share of letters that a misspelt name has in common with the one that is meant: "rwo" and "row" 0.67,
"colour" and "clutter" 0.62."""
_BEGINNING = 3
"""Letters from which the beginning of a name is enough."""


def closest(given: object, known: Iterable[str]) -> str:
    """The known name that is most like a misspelt one, or begins with it; "" if none is."""
    text = str(given).lower()
    names = {name.lower(): name for name in known}
    found = difflib.get_close_matches(text, list(names), n=1, cutoff=_LIKE)
    if not found and len(text) >= _BEGINNING:
        found = [name for name in names if name.startswith(text)]
    return names[found[0]] if found else ""


def printable(text: str) -> str:
    """A text with its control characters as escapes, so that a terminal does not obey them; lines stay."""
    return "".join(
        each
        if each.isprintable() or each in "\n\t"
        else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


def first_names(names: Sequence[str], most: int, others: str = " and {} more") -> str:
    """The first names, joined by commas, and how many others there are."""
    more = others.format(len(names) - most) if len(names) > most else ""
    return ", ".join(names[:most]) + more


def range_text(least: int, most: int, nothing: str = "none") -> str:
    """The whole numbers from `least` to `most` as text for an error; `nothing` where there is none."""
    if most < least:
        return nothing
    return f"{least} to {most}" if least < most else f"{least}"


class ClutterGenError(Exception):
    """Base of every error that this package raises on purpose.

    Args:
      given: what was given.
      allowed: what is allowed; hint: what to try.
      meant: the name that was probably meant (`closest`).
    """

    def __init__(self, given: str, allowed: str = "", hint: str = "", meant: str = "") -> None:
        if len(given) > _LONGEST:
            # What a file says may have any length.
            given = f"{given[: _LONGEST // 2]} [...] {given[-_LONGEST // 2 :]}"
        self.given = given
        self.allowed = allowed
        self.hint = hint
        self.meant = meant
        parts = [given.rstrip(".") + "."]
        if meant:
            parts.append(f"Did you mean {meant!r}?")
        if allowed:
            parts.append(f"Allowed: {allowed.rstrip('.')}.")
        if hint:
            parts.append(f"Try: {hint.rstrip('.')}.")
        super().__init__(" ".join(parts))


class ConfigError(ClutterGenError, ValueError):
    """A setting is outside its range or contradicts another."""


class AssetError(ClutterGenError):
    """A mesh, an object or a support cannot be made into a sound body."""


class PoolError(ClutterGenError):
    """A pool, a support or a checkpoint cannot be found or read."""


class BankError(ClutterGenError):
    """A bank of scenes cannot be read, written or continued."""


class UnsafePathError(ClutterGenError):
    """A name that a file gave leads out of the folder that it belongs to."""


class MissingExtraError(ClutterGenError, ImportError):
    """An optional dependency is not installed."""

    def __init__(self, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the optional extra {extra!r}, which is not installed",
            hint=f"pip install '.[{extra}]' in a checkout of cluttergen_jax",
        )
