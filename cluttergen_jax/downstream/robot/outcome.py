"""How an attempt to move an object ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from cluttergen_jax.downstream.episodes.outcome import Failed, Outcome
from cluttergen_jax.errors import BankError
from cluttergen_jax.statistics import share_of


@dataclass(frozen=True)
class Ending:
    """How an episode ended; outcome: an `Outcome` or another text of its kind; detail: of what, in words."""

    outcome: str
    detail: str

    @property
    def is_success(self) -> bool:
        """Nothing went wrong."""
        return self.outcome == Outcome.SUCCESS


class EpisodeRow(Protocol):
    """What films and recordings have to know of an episode (`Ending`), and its simulated seconds."""

    @property
    def outcome(self) -> str: ...
    @property
    def detail(self) -> str: ...
    @property
    def is_success(self) -> bool: ...
    @property
    def seconds(self) -> float: ...


def run_to_end(run: Callable[[], None]) -> tuple[str, str]:
    """Runs an episode: its outcome, and of what (`Ending`)."""
    try:
        run()
    except Failed as failure:
        return str(failure.outcome), failure.detail
    return str(Outcome.SUCCESS), ""


def ending_of(row: EpisodeRow) -> str:
    """How an episode ended, and of what."""
    return f"{row.outcome}: {row.detail}".strip(" :")


def check_repeated(number: int, known: EpisodeRow, found: EpisodeRow) -> None:
    """Refuses an episode that was run once more and ended in another way (BankError)."""
    if (found.outcome, found.detail) != (known.outcome, known.detail):
        raise BankError(
            f"episode {number} ended with {ending_of(known)!r}, and run again with {ending_of(found)!r}",
            "episodes that end as they did, as those of the same version and machine do",
            "another `out`",
        )


class Endings:
    """What became of episodes, `rows`."""

    rows: tuple[Ending, ...]

    @property
    def success_rate(self) -> float:
        """Share of all episodes."""
        return sum(row.is_success for row in self.rows) / max(len(self.rows), 1)

    def causes(self) -> list[str]:
        """A line that counts the failures by cause, where there are any."""
        return [f"failures: {causes_of(self.rows)}"] if self.success_rate < 1 and self.rows else []


def success_of(rows: Sequence[Ending]) -> str:
    """The share of successes, as tables show it."""
    return share_of(sum(row.is_success for row in rows), len(rows))


def causes_of(rows: Sequence[Ending]) -> str:
    """How often each cause of failure came, the most frequent first; "-" where none did."""
    causes = Counter(row.outcome for row in rows if not row.is_success)
    return ", ".join(f"{name} {count}" for name, count in causes.most_common()) or "-"
