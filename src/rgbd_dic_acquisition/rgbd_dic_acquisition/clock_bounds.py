"""Where the offset of a clock can be, from moments that bound it on both sides.

As long as the rates of two clocks differ by a constant amount, the offset is a line over time. Each latch says between
what it was at that time. The lines that no latch contradicts are a convex polygon in the plane of offset and rate, and
what they leave open at any other time is between its corners. That holds for certain, however long the answers took.
"""

from __future__ import annotations

STRETCHES = 60  # of the window; the narrowest bounds of each are kept
Corner = tuple[float, float]  # offset at the newest latch [ns], rate


class OffsetBounds:
    """Follows one clock over a sliding window; if its rate changed within that, over the newest part that agrees.

    Args:
        window_ns: how far back latches count [ns of device time].
        max_rate: largest difference in rate of the two clocks, without unit.
    """

    def __init__(self, window_ns: int, max_rate: float) -> None:
        self._window_ns, self._width_ns, self._max_rate = window_ns, max(window_ns // STRETCHES, 1), max_rate
        self._latches: list[tuple[int, int, int]] = []  # device time, lowest and highest offset
        self._corners: list[Corner] = []

    def __bool__(self) -> bool:
        return bool(self._latches)

    def add(self, device_ns: int, low_ns: int, high_ns: int) -> None:
        """The offset was between these at a device time."""
        newest_ns = max(device_ns, self._latches[-1][0]) if self._latches else device_ns
        kept = {each[0] // self._width_ns: each for each in self._latches if each[0] >= newest_ns - self._window_ns}
        before = kept.get(device_ns // self._width_ns)
        if before is None or high_ns - low_ns <= before[2] - before[1]:
            kept[device_ns // self._width_ns] = (device_ns, low_ns, high_ns)
        self._latches = sorted(kept.values())
        self._corners = self._agreeing()

    def at(self, device_ns: int) -> tuple[float, float]:
        """Lowest and highest offset at a device time [ns]."""
        origin_ns, low_ns, _ = self._latches[-1]
        offsets = [offset + rate * (device_ns - origin_ns) for offset, rate in self._corners]
        return low_ns + min(offsets), low_ns + max(offsets)

    def _agreeing(self) -> list[Corner]:
        """Corners of the polygon; offsets relative to the lowest at the newest latch, so that they are exact."""
        origin_ns, zero_ns, high_ns = self._latches[-1]
        width = float(high_ns - zero_ns)
        corners = [(0.0, -self._max_rate), (width, -self._max_rate), (width, self._max_rate), (0.0, self._max_rate)]
        for device_ns, low_ns, high_ns in self._latches[-2::-1]:
            time = float(device_ns - origin_ns)
            narrower = _cut(_cut(corners, time, 1.0, float(high_ns - zero_ns)), time, -1.0, float(zero_ns - low_ns))
            if not narrower:
                break
            corners = narrower
        return corners


def _cut(corners: list[Corner], time: float, side: float, limit: float) -> list[Corner]:
    """The part of a convex polygon where side * (offset + rate * time) <= limit; empty if there is none."""
    over = [side * (offset + rate * time) - limit for offset, rate in corners]
    kept: list[Corner] = []
    for k, (here, above) in enumerate(zip(corners, over, strict=True)):
        before, above_before = corners[k - 1], over[k - 1]
        if (above <= 0) != (above_before <= 0):
            part = above_before / (above_before - above)
            kept.append((before[0] + part * (here[0] - before[0]), before[1] + part * (here[1] - before[1])))
        if above <= 0:
            kept.append(here)
    return kept
