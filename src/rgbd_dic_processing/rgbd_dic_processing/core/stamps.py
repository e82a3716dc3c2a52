"""Stamps of one sensor whose clock may jump back: which come after which all the same."""

from __future__ import annotations

Place = tuple[int, int]  # stretch and stamp [ns]; a later one is greater, whatever the clock did between them

JUMP_BACK_NS = 100_000_000  # a clock that jumps back by less is not told from a frame that came late, or twice


class Stretches:
    """Divides a stream of stamps into stretches in which they increase; a jump back of the clock begins a new one.

    It depends on the stream alone: two that read it agree, whatever else they have read by then. And two sensors whose
    common clock jumps agree: how far it jumped is counted from where the next stamp was due.

    Attributes:
        newest: the greatest place so far.
    """

    def __init__(self) -> None:
        self.newest: Place = (0, -1)
        self._period_ns: int | None = None  # shortest step so far

    def place(self, stamp_ns: int) -> Place:
        """The place of the next stamp; not greater than `newest` was before if it came late or twice."""
        stretch, newest_ns = self.newest
        step_ns = stamp_ns - newest_ns
        if newest_ns >= 0 and 0 < step_ns <= (self._period_ns or step_ns):
            self._period_ns = step_ns
        place = (stretch + ((self._period_ns or 0) - step_ns > JUMP_BACK_NS), stamp_ns)
        self.newest = max(self.newest, place)
        return place
