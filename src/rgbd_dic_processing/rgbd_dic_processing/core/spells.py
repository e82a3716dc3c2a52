"""Frames in succession that share a state, and times without frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GAP = 1.75  # frames farther apart than so many periods have at least one missing between them


@dataclass(frozen=True)
class Spell:
    """`frames` frames in succession with one state, half a period on both ends included [s]."""

    state: int
    begin_s: float
    end_s: float
    frames: int


def period_of(time_s: Array) -> float:
    """The usual time between frames (n,), the median; 0 for less than two."""
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0


def gaps_of(time_s: Array) -> list[tuple[float, float]]:
    """Begin and end [s] of each time without frames: from a period after the last to the next one's."""
    period = period_of(time_s)
    after = np.flatnonzero(np.diff(time_s) > GAP * period)
    return [(float(time_s[i] + period / 2), float(time_s[i + 1] - period / 2)) for i in after]


def spells_of(time_s: Array, states: NDArray[np.int64]) -> list[Spell]:
    """The spells of frames (n,) in the order of their times; a gap ends one."""
    if not len(time_s):
        return []
    half = period_of(time_s) / 2
    ends = np.flatnonzero((np.diff(states) != 0) | (np.diff(time_s) > GAP * 2 * half))
    first, last = np.append(0, ends + 1), np.append(ends, len(time_s) - 1)
    return [
        Spell(int(states[a]), float(time_s[a] - half), float(time_s[b] + half), int(b - a + 1))
        for a, b in zip(first, last, strict=True)
    ]
