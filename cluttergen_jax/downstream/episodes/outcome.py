"""How an attempt to move an object ends."""

from __future__ import annotations

import math
from enum import StrEnum


class Outcome(StrEnum):
    """The end of an episode; all but the first are failures, in the order in which they can come.

    NO_GRASP: no grasp of the object is free of contact. NO_IK: the arm does not reach it. NO_PATH: there was
    no way to it or with it. NO_PLACE: no place was proposed in the region, or none for which the hand has
    room. CONTACT: the arm or what it held touched what it should not, by more than 2 N. SLIP: the object was
    lost, or slipped in the hand. DISPLACED: another object moved. UNSTABLE: something did not stay. OUTSIDE:
    the object does not stand where it should.
    """

    SUCCESS = "success"
    NO_GRASP = "no grasp"
    NO_IK = "no ik"
    NO_PATH = "no path"
    NO_PLACE = "no place"
    CONTACT = "contact"
    SLIP = "slip"
    DISPLACED = "displaced"
    UNSTABLE = "unstable"
    OUTSIDE = "outside"


class Failed(Exception):
    """An episode ends; outcome: how, an `Outcome` or another text of its kind. detail: of what, in words."""

    def __init__(self, outcome: StrEnum, detail: str = "") -> None:
        super().__init__(f"{outcome}: {detail}" if detail else str(outcome))
        self.outcome = outcome
        self.detail = detail


class Cause(StrEnum):
    """How an episode ends without success, besides `Outcome`.

    NOT_SEEN: the observer never saw an object. NO_LAYOUT: no layout was found. NO_ORDER: there is no order of
    picks, buffers included, that the arm can do. MISPLACED: an object was not where it should be in the end.
    """

    NOT_SEEN = "not seen"
    NO_LAYOUT = "no layout"
    NO_ORDER = "no order"
    MISPLACED = "misplaced"


def told_motion(shift: float, turn: float) -> str:
    """Metres and radians in words."""
    return f"{1e3 * shift:.0f} mm, {math.degrees(turn):.0f} deg"
