"""Rectangles in a mask: the largest one, and few that cover it without overlapping."""

from __future__ import annotations

import numpy as np

Span = tuple[int, int, int, int]


def largest_rectangle(mask: np.ndarray) -> Span:
    """The largest all-True rectangle of a bool[X, Y]: x from, x to, y from, y to; ends are exclusive.

    Row by row, the lengths of the True runs that end there form a histogram whose largest rectangle a stack
    finds in one pass. (0, 0, 0, 0) if nothing is True.
    """
    best, best_area = (0, 0, 0, 0), 0
    run = np.zeros(mask.shape[1] + 1, int)
    for x, row in enumerate(mask):
        run[:-1] = np.where(row, run[:-1] + 1, 0)
        stack: list[tuple[int, int]] = []
        for y, length in enumerate(run.tolist()):
            start = y
            while stack and stack[-1][1] >= length:
                start, tall = stack.pop()
                if tall * (y - start) > best_area:
                    best_area = tall * (y - start)
                    best = (x + 1 - tall, x + 1, start, y)
            stack.append((start, length))
    return best


def cover(mask: np.ndarray, missing: float = 0.005, limit: int = 40) -> list[Span]:
    """Disjoint rectangles inside a bool[X, Y], largest first.

    Args:
      missing: share of the True cells that may stay uncovered.
      limit: rectangles at most.
    """
    rest = mask.copy()
    spans: list[Span] = []
    allowed = missing * mask.sum()
    while rest.sum() > allowed and len(spans) < limit:
        span = largest_rectangle(rest)
        spans.append(span)
        rest[span[0] : span[1], span[2] : span[3]] = False
    return spans
