"""The numbers of the page: each method in one line, and why frames are not valid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.spells import spells_of
from ..core.status import FrameStatus
from ..results import Comparison
from .series import STATUS_WORDS, Series


@dataclass(frozen=True)
class MethodSummary:
    """One method over the run; NaN where the run cannot tell.

    rms_mm, mean_error_mm, worst_error_mm: error against the truth. within_2u: share of the compared frames
    whose error is at most two stated standard uncertainties. widest_mm: the largest opening, with its sign.
    """

    method: str
    frames: int
    valid: int
    rms_mm: float
    mean_error_mm: float
    worst_error_mm: float
    within_2u: float
    mean_u_mm: float
    last_mm: float
    widest_mm: float


@dataclass(frozen=True)
class Failure:
    """Frames of one method that share a status; `example` is the commonest reason given.

    longest_s: the longest time that it lasted in one piece.
    """

    method: str
    words: str
    count: int
    first_s: float
    last_s: float
    longest_s: float
    example: str


def summarise(methods: Sequence[Series]) -> list[MethodSummary]:
    """One line for each method, in their order."""
    return [_summary(series) for series in methods]


def failures(methods: Sequence[Series]) -> list[Failure]:
    """Each status other than valid of each method, the most frequent first."""
    found = []
    for series in methods:
        spells = spells_of(series.time_s, series.status)
        for status in sorted(set(series.status.tolist()) - {int(FrameStatus.OK)}):
            where = np.flatnonzero(series.status == status)
            reasons = Counter(series.openings[i].reason for i in where)
            kinds = len(reasons)
            example = reasons.most_common(1)[0][0] + (f" (and {kinds - 1} like it)" if kinds > 1 else "")
            words = STATUS_WORDS.get(FrameStatus(status), FrameStatus(status).name)
            longest_s = max(spell.end_s - spell.begin_s for spell in spells if spell.state == status)
            first_s, last_s = (float(series.time_s[i]) for i in where[[0, -1]])
            found.append(Failure(series.method, words, len(where), first_s, last_s, longest_s, example))
        found.sort(key=lambda failure: -failure.count)
    return found


def _summary(series: Series) -> MethodSummary:
    opening = series.opening_mm[series.valid]
    rms = mean = worst = within = math.nan
    compared = np.isfinite(series.error_mm)
    error = series.error_mm[compared]
    if len(error):
        rms = Comparison(series.method, len(compared), len(error), error * 1e-3).rms_m * 1e3
        mean, worst = float(error.mean()), float(np.abs(error).max())
        within = float(np.mean(np.abs(error) <= 2 * series.u_mm[compared]))
    u = series.u_mm[np.isfinite(series.u_mm)]
    return MethodSummary(
        series.method,
        len(series.openings),
        int(series.valid.sum()),
        rms,
        mean,
        worst,
        within,
        float(u.mean()) if len(u) else math.nan,
        float(opening[-1]) if len(opening) else math.nan,
        float(opening[np.argmax(np.abs(opening))]) if len(opening) else math.nan,
    )
