"""The openings of a flight in little memory, and what was measured unheard put into its place."""

from __future__ import annotations

from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RESTART_S = 1.0  # an opening so much older than the last one belongs to another flight
MOST = 1 << 20  # openings that are kept, five hours at 60 Hz; then the older half is forgotten


@dataclass(frozen=True)
class Openings:
    """N openings. stamps_ns: (N,) int64, of their images; opening_m, u_m: (N,) float32 [m], NaN where not valid."""

    stamps_ns: NDArray[np.int64]
    opening_m: NDArray[np.float32]
    u_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def where(self, mask: NDArray[np.bool_] | slice) -> Openings:
        return Openings(self.stamps_ns[mask], self.opening_m[mask], self.u_m[mask])


class OpeningLog:
    """Openings in the order in which they come, which is that of their images.

    Attributes:
        flight: number of the flight; a clock that jumps back, as when a bag is played again, begins another, and so
            does what is put between those that are here.
        forgotten: how many of the oldest of this flight are here no more.
    """

    def __init__(self) -> None:
        self.flight = self.forgotten = 0
        self._stamps_ns, self._opening_m, self._u_m = array("q"), array("f"), array("f")

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def add(self, stamp_ns: int, opening_m: float, u_m: float) -> None:
        if len(self) and stamp_ns < self._stamps_ns[-1] - RESTART_S * 1e9:
            self._begin()
        self._stamps_ns.append(stamp_ns)
        self._opening_m.append(opening_m)
        self._u_m.append(u_m)
        if len(self) > MOST:
            self.forgotten += MOST // 2
            for column in self._columns():
                del column[: MOST // 2]

    def kept(self, start: int = 0) -> Openings:
        """Those from this place on."""
        return Openings(*(np.array(column[start:], column.typecode) for column in self._columns()))

    def fill(self, known: Openings) -> None:
        """Put what is known of a flight in place of what is here of its time; of another flight, in place of all."""
        if not len(known):
            return
        here, first, last = self.kept(), known.stamps_ns[0], known.stamps_ns[-1]
        if len(here) and here.stamps_ns[-1] > last + RESTART_S * 1e9:
            here = here.where(slice(0))
        parts = (here.where(here.stamps_ns < first), known, here.where(here.stamps_ns > last))
        self._begin()
        for part in parts:
            for column, values in zip(self._columns(), (part.stamps_ns, part.opening_m, part.u_m), strict=True):
                column.frombytes(values.astype(column.typecode).tobytes())

    def _columns(self) -> tuple[array, array, array]:
        return self._stamps_ns, self._opening_m, self._u_m

    def _begin(self) -> None:
        self.flight += 1
        self.forgotten = 0
        for column in self._columns():
            del column[:]
