"""By what the last bits of a bank's scenes were computed, and whether more of them may be made here.

A record's `bits` are a list of `numerics.bits_of_here`, one for each kind of process that made scenes. Banks
of older versions, and banks that a person makes, have none, and are continued anywhere.
"""

from __future__ import annotations

from pathlib import Path

from cluttergen_jax.errors import BankError

Bits = dict[str, str]


def check_bits(path: Path, ours: Bits, known: list[Bits]) -> None:
    """Refuses to mix scenes that one recipe makes differently.

    Raises:
      BankError: what differs here from what made the bank.
    """
    if ours not in known:
        raise BankError(
            f"{path} would get scenes of other bits than those it has, so that equal seeds would not mean "
            f"equal scenes: {'; '.join(differences(ours, known[-1]))}",
            "the machine and the settings that made it",
            "another `out`, `overwrite` to begin anew, or `allow_other_bits` for a bank that is a mixture",
        )


def differences(ours: Bits, theirs: Bits) -> list[str]:
    """What differs, and where many words are alike those that are not."""
    lines = []
    for name in sorted({*ours, *theirs}):
        here, there = ours.get(name, "").split(), theirs.get(name, "").split()
        if here != there:
            only_here = " ".join(word for word in here if word not in there) or "nothing more"
            only_there = " ".join(word for word in there if word not in here) or "nothing more"
            lines.append(f"{name} (here {only_here}, the bank {only_there})")
    return lines


def are_bits(value: object) -> bool:
    """Whether a record's `bits` can be what a writer put there."""
    return isinstance(value, list) and bool(value) and all(map(_is_one, value))


def _is_one(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(each, str) for each in value.values())
