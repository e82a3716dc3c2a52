"""One history beside its reference: delay and difference by both interpolations, and the two spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.crack import CrackOpening
from .alignment import Alignment, Difference, align, difference
from .interpolation import INTERPOLATIONS
from .record import History, history_of
from .settings import AlignmentSettings
from .spectrum import Spectrum, spectrum


@dataclass(frozen=True)
class HistoryComparison:
    """Two histories of one crack.

    alignments, sliding: by the name of the interpolation; the sliding is compared at the delay found for the opening,
    and NaN where the reference has none. ours, reference: spectra [m] of the openings over the time that both cover.
    """

    alignments: dict[str, Alignment]
    sliding: dict[str, Difference]
    ours: Spectrum
    reference: Spectrum


def compare_histories(
    ours: History, reference: History, settings: AlignmentSettings | None = None
) -> HistoryComparison:
    """Compare two histories of one crack.

    Raises:
        RgbdDicError: as `align` and `spectrum`.
    """
    alignments = {name: align(ours, reference, name, settings) for name in INTERPOLATIONS}
    delay = alignments["spline"].delay_s
    first = max(ours.time_s[0], reference.time_s[0] - delay)
    last = min(ours.time_s[-1], reference.time_s[-1] - delay)
    mine, other = ours.between(first, last), reference.between(first + delay, last + delay)
    return HistoryComparison(
        alignments,
        {name: _sliding(ours, reference, name, alignment.delay_s) for name, alignment in alignments.items()},
        spectrum(mine.time_s, mine.opening_m),
        spectrum(other.time_s, other.opening_m),
    )


@dataclass(frozen=True)
class MethodComparison:
    """One method of a run beside the reference; `comparison` is None where `reason` says why there is none."""

    method: str
    comparison: HistoryComparison | None
    reason: str


def compare_run(
    openings: Sequence[CrackOpening], reference: History, start_ns: int, settings: AlignmentSettings | None = None
) -> list[MethodComparison]:
    """Each method of a run beside the reference, its time counted from `start_ns`.

    Raises:
        RgbdDicError: if no method can be compared.
    """
    found = []
    for method in dict.fromkeys(opening.method for opening in openings):
        try:
            comparison = compare_histories(history_of(openings, method, start_ns), reference, settings)
            found.append(MethodComparison(method, comparison, ""))
        except RgbdDicError as error:
            found.append(MethodComparison(method, None, str(error)))
    if all(one.comparison is None for one in found):
        raise RgbdDicError("; ".join(f"{one.method}: {one.reason}" for one in found) or "the run has no crack opening")
    return found


def _sliding(ours: History, reference: History, interpolation: str, delay_s: float) -> Difference:
    if not np.isfinite(reference.sliding_m).any():
        return difference(np.zeros(0), np.zeros(0))
    curve = INTERPOLATIONS[interpolation](ours.time_s, ours.sliding_m)
    return difference(curve(reference.time_s - delay_s), reference.sliding_m)
