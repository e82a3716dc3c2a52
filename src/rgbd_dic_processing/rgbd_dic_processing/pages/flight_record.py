"""The openings that the live page has seen, for its figures and its strip charts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..core.crack import CrackOpening

RESTART_S = 1.0  # an opening so much older than the last one belongs to another flight
MOST = 1 << 20  # openings of one flight, five hours at 60 Hz; then the older half is forgotten


class FlightRecord:
    """All openings of a flight, by the time of their images.

    Attributes:
        last: the latest one; None before the first.
        flight: number of the flight; a clock that jumps back, as when a bag is played again, begins another.
    """

    def __init__(self) -> None:
        self.last: CrackOpening | None = None
        self.flight = 0
        self._clear()

    def _clear(self) -> None:
        self._start_ns = 0
        self._first = 0  # number of the oldest sample that is kept
        self._samples: list[tuple[float, float, float]] = []  # time [s], opening and its uncertainty [mm]; NaN: invalid

    def add(self, opening: CrackOpening) -> None:
        """Openings come in the order of their images, but for a clock that jumps back."""
        if self.last is not None and opening.stamp_ns < self.last.stamp_ns - RESTART_S * 1e9:
            self._clear()
            self.flight += 1
        if not self._samples:
            self._start_ns = opening.stamp_ns
        self.last = opening
        self._samples.append((self.time_s(opening.stamp_ns), opening.opening_m * 1e3, opening.u_opening_m * 1e3))
        if len(self._samples) > MOST:
            self._first += MOST // 2
            del self._samples[: MOST // 2]

    def time_s(self, stamp_ns: int) -> float:
        """Since the first opening of the flight [s]."""
        return (stamp_ns - self._start_ns) * 1e-9

    def since(self, number: int, window_s: float) -> tuple[list[list[float | None]], int]:
        """The samples from this number on that are not older than the window: [time, opening, u], None for NaN.

        Returns:
            They, and the number to ask for next.
        """
        start = max(number - self._first, 0)
        oldest = self._samples[-1][0] - window_s if self._samples else 0.0
        fresh = [sample for sample in self._samples[start:] if sample[0] >= oldest]
        return [[round(t, 4), *_shown(value, u)] for t, value, u in fresh], self._first + len(self._samples)

    def overview(self, bins: int) -> dict[str, Any]:
        """The whole flight in bins of time: lowest and highest opening [mm] (None: no valid one), share of invalid."""
        if not self._samples:
            return {"end": 0.0, "low": [], "high": [], "invalid": []}
        time_s, opening, _ = np.array(self._samples).T
        end = max(float(time_s[-1]), 1.0)
        place = np.clip((time_s / end * bins).astype(int), 0, bins - 1)
        valid = np.isfinite(opening)
        low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
        np.minimum.at(low, place[valid], opening[valid])
        np.maximum.at(high, place[valid], opening[valid])
        count = np.bincount(place, minlength=bins)
        invalid = np.bincount(place[~valid], minlength=bins) / np.maximum(count, 1)
        return {
            "end": round(end, 3),
            "low": [round(v, 5) if math.isfinite(v) else None for v in low.tolist()],
            "high": [round(v, 5) if math.isfinite(v) else None for v in high.tolist()],
            "invalid": [round(v, 2) for v in invalid.tolist()],
        }


def _shown(*values: float) -> list[float | None]:
    return [round(value, 6) if math.isfinite(value) else None for value in values]
