"""The openings of a flight, for the figures and the strip charts of the live page."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..core.crack import CrackOpening
from ..core.opening_log import OpeningLog, Openings


class FlightRecord:
    """All openings of a flight, by the time of their images.

    Attributes:
        last: the latest one that was heard; None before the first.
    """

    def __init__(self) -> None:
        self.last: CrackOpening | None = None
        self._log = OpeningLog()
        self._start_ns = 0

    @property
    def flight(self) -> int:
        """As of OpeningLog."""
        return self._log.flight

    def add(self, opening: CrackOpening) -> None:
        """Openings come in the order of their images, but for a clock that jumps back."""
        self._log.add(opening.stamp_ns, opening.opening_m, opening.u_opening_m)
        if len(self._log) == 1:
            self._start_ns = opening.stamp_ns
        self.last = opening

    def fill(self, known: Openings) -> None:
        """What was measured before anybody looked."""
        self._log.fill(known)
        if len(self._log):
            self._start_ns = int(self._log.kept().stamps_ns[0])

    def time_s(self, stamp_ns: int) -> float:
        """Since the first opening of the flight [s]."""
        return (stamp_ns - self._start_ns) * 1e-9

    def since(self, number: int, window_s: float) -> tuple[list[list[float | None]], int]:
        """The samples from this number on that are not older than the window: [time, opening, u], None for NaN.

        Returns:
            They, and the number to ask for next.
        """
        fresh = self._log.kept(max(number - self._log.forgotten, 0))
        if len(fresh):
            fresh = fresh.where(fresh.stamps_ns >= fresh.stamps_ns[-1] - window_s * 1e9)
        columns = (self._times_s(fresh), fresh.opening_m * 1e3, fresh.u_m * 1e3)
        shown = [[round(t, 4), *_shown(value, u)] for t, value, u in zip(*(c.tolist() for c in columns), strict=True)]
        return shown, self._log.forgotten + len(self._log)

    def overview(self, bins: int) -> dict[str, Any]:
        """The whole flight in bins of time: lowest and highest opening [mm] (None: no valid one), share of invalid."""
        if not len(self._log):
            return {"end": 0.0, "low": [], "high": [], "invalid": []}
        openings = self._log.kept()
        time_s, opening_mm = self._times_s(openings), openings.opening_m * 1e3
        end = max(float(time_s[-1]), 1.0)
        place = np.clip((time_s / end * bins).astype(int), 0, bins - 1)
        valid = np.isfinite(opening_mm)
        low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
        np.minimum.at(low, place[valid], opening_mm[valid])
        np.maximum.at(high, place[valid], opening_mm[valid])
        count = np.bincount(place, minlength=bins)
        invalid = np.bincount(place[~valid], minlength=bins) / np.maximum(count, 1)
        return {
            "end": round(end, 3),
            "low": [round(v, 5) if math.isfinite(v) else None for v in low.tolist()],
            "high": [round(v, 5) if math.isfinite(v) else None for v in high.tolist()],
            "invalid": [round(v, 2) for v in invalid.tolist()],
        }

    def _times_s(self, openings: Openings) -> np.ndarray:
        return (openings.stamps_ns - self._start_ns) * 1e-9


def _shown(*values: float) -> list[float | None]:
    return [round(value, 6) if math.isfinite(value) else None for value in values]
