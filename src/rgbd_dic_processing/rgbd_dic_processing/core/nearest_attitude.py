"""Which attitude of the vehicle belongs to an image: the nearest in time."""

from __future__ import annotations

import bisect
from dataclasses import dataclass

from .stamps import JUMP_BACK_NS

KEPT = 512  # attitudes: ten seconds at 50 Hz, longer than any pair waits


@dataclass(frozen=True)
class Attitude:
    """orientation_xyzw: quaternion of R_world_body, world east-north-up, body forward-left-up."""

    stamp_ns: int
    orientation_xyzw: tuple[float, float, float, float]


class NearestAttitude:
    """Keeps the latest attitudes. It never waits for one: what has not come when a pair is settled is left out."""

    def __init__(self, max_offset_s: float):
        self._limit_ns = max_offset_s * 1e9
        self._known: list[Attitude] = []

    def add(self, attitude: Attitude) -> None:
        """One that came late is put into its place. A jump back of the clock drops those from before it."""
        if self._known and attitude.stamp_ns < self._known[-1].stamp_ns - JUMP_BACK_NS:
            self._known.clear()
        bisect.insort(self._known, attitude, key=lambda known: known.stamp_ns)
        if len(self._known) > KEPT:
            self._known.pop(0)

    def at(self, stamp_ns: int) -> Attitude | None:
        """The nearest to a stamp, the earlier of two equally near; None if it is farther than the limit."""
        index = bisect.bisect_left(self._known, stamp_ns, key=lambda known: known.stamp_ns)
        around = self._known[max(index - 1, 0) : index + 1]
        nearest = min(around, key=lambda known: abs(known.stamp_ns - stamp_ns), default=None)
        return nearest if nearest is not None and abs(nearest.stamp_ns - stamp_ns) <= self._limit_ns else None
