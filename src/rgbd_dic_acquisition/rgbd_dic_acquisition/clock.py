"""Device time to host time, from the arrival of what a device sends or from latches of its clock.

*Arrivals.* Each sample says: arrival - device time = offset + delivery. The delivery is never negative, often
nearly constant and at times very long; the rates of two oscillators differ by a nearly constant amount. So the
offset is the line that supports the cloud of (device time, arrival - device time) from below. The shortest
delivery itself cannot be seen from one side; `fixed_delay_ns` takes it off where it is known.

*Latches.* Where the host can ask the device for its time, the answer belongs to a moment between the question
and the answer. So every latch bounds the offset from both sides (`clock_bounds`), and half of what all of them leave
open is what remains unknown, the delivery of the frames with it. Once a clock is latched, arrivals no longer count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from .clock_bounds import OffsetBounds
from .errors import SettingsError

NS = 1_000_000_000
# A device time this far back is a restart of the device, not a packet that was overtaken [ns].
RESTART_NS = 1 * NS
# The host's clock was set if the offset changes by more than this [ns] ...
STEP_NS = NS // 2
# ... and, where that is later, does so in all samples of this long: single ones are only late [ns].
LATE_NS = 2 * NS


@dataclass(frozen=True)
class HostStamp:
    """Host time of an event on the device.

    Attributes:
        stamp_ns: host time [ns since the epoch]; later for a later device time, never after the arrival of
            its own sample, and without jumps back while the estimate converges.
        uncertainty_ns: standard uncertainty of it [ns], without the shortest delivery if the clock was never
            latched; infinite until known.
    """

    stamp_ns: int
    uncertainty_ns: float


@dataclass
class HostClock:
    """Follows the offset of one device's clock over a sliding window. Not for two threads at a time.

    Attributes:
        window_ns: how far back samples count [ns of device time].
        resolution_ns: step of the device's time stamps [ns]; they are taken to be cut off, not rounded.
        fixed_delay_ns: shortest time from the event to its arrival [ns], if known; counts without latches.
        max_rate: largest difference in rate of the two clocks, without unit; the window must see a second of
            it before a rate is believed at all.
        restarts: how often the estimate has begun anew, as the device's time has jumped back or the host's
            clock was set by more than half a second.
    """

    window_ns: int = 30 * NS
    resolution_ns: int = 1
    fixed_delay_ns: int = 0
    max_rate: float = 500e-6
    restarts: int = 0
    _above: _SupportingLine = field(init=False, repr=False)
    _between: OffsetBounds = field(init=False, repr=False)  # empty until latched
    _newest_ns: int | None = field(default=None, init=False, repr=False)
    _last: tuple[int, int] | None = field(default=None, init=False, repr=False)
    _late_since: tuple[int, int] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.window_ns < NS or self.resolution_ns < 1:
            raise SettingsError(
                f"HostClock: window_ns = {self.window_ns} must be at least {NS}, resolution_ns = "
                f"{self.resolution_ns} at least 1"
            )
        self._forget()

    @property
    def latched(self) -> bool:
        """Whether the stamps come from latches."""
        return bool(self._between)

    def latch(self, device_ns: int, before_ns: int, after_ns: int) -> None:
        """Take into account that the device's clock was at `device_ns` between two host times."""
        self._advance(device_ns)
        middle_ns = (before_ns + after_ns) // 2 - device_ns
        if self.latched and abs(middle_ns - self._offset(device_ns)) > STEP_NS + (after_ns - before_ns) / 2:
            self._begin_anew()
            self._advance(device_ns)
        self._between.add(device_ns, before_ns - device_ns - (self.resolution_ns - 1), after_ns - device_ns)

    def stamp(self, device_ns: int, arrival_ns: int) -> HostStamp:
        """Map a device time to host time; without latches its arrival is a sample itself."""
        self._advance(device_ns)
        if not self.latched:
            if self._was_set(device_ns, arrival_ns):
                self._begin_anew()
                self._advance(device_ns)
            self._above.add(device_ns, arrival_ns - device_ns)
        # Time that was cut off is half a step early on average; the envelope follows those that are least so.
        stamp_ns = device_ns + math.floor(self._offset(device_ns)) + self.resolution_ns // 2
        stamp_ns -= 0 if self.latched else self.fixed_delay_ns
        return HostStamp(self._monotone(device_ns, stamp_ns, arrival_ns), self._uncertainty(device_ns))

    def _offset(self, device_ns: int) -> float:
        return sum(self._between.at(device_ns)) / 2 if self.latched else self._above.at(device_ns)

    def _uncertainty(self, device_ns: int) -> float:
        """Half of what the latches leave open, taken as evenly distributed, or the scatter of the lowest arrivals."""
        resolution_ns = self.resolution_ns / math.sqrt(12)
        if not self.latched:
            return math.hypot(self._above.scatter(), resolution_ns)
        low_ns, high_ns = self._between.at(device_ns)
        return math.hypot((high_ns - low_ns) / 2 / math.sqrt(3), resolution_ns)

    def _advance(self, device_ns: int) -> None:
        if self._newest_ns is not None and device_ns < self._newest_ns - RESTART_NS:
            self._begin_anew()
        self._newest_ns = max(device_ns, self._newest_ns or device_ns)

    def _was_set(self, device_ns: int, arrival_ns: int) -> bool:
        """Whether the host's clock was set: back, or forward, which a backlog that is read at once is not."""
        if not self._above:
            return False
        late_ns = arrival_ns - device_ns - self._above.at(device_ns)
        if late_ns <= STEP_NS:
            self._late_since = None
            return late_ns < -STEP_NS
        self._late_since = self._late_since or (device_ns, arrival_ns)
        return min(device_ns - self._late_since[0], arrival_ns - self._late_since[1]) > LATE_NS

    def _begin_anew(self) -> None:
        self._forget()
        self._newest_ns = self._last = None
        self.restarts += 1

    def _forget(self) -> None:
        self._above = _SupportingLine(self.window_ns, self.max_rate)
        self._between = OffsetBounds(self.window_ns, self.max_rate)
        self._late_since = None

    def _monotone(self, device_ns: int, stamp_ns: int, arrival_ns: int) -> int:
        """While the estimate falls, go on at no less than half the device's pace instead of jumping back."""
        if self._last is not None:
            last_device_ns, last_stamp_ns = self._last
            elapsed = device_ns - last_device_ns
            if elapsed <= 0:  # overtaken by a later packet: same mapping, the order stays as the device says
                return min(stamp_ns, last_stamp_ns + elapsed, arrival_ns)
            stamp_ns = max(stamp_ns, last_stamp_ns + (elapsed + 1) // 2)
        stamp_ns = min(stamp_ns, arrival_ns)
        if self._last is not None and stamp_ns <= self._last[1]:
            stamp_ns = self._last[1] + 1  # the host's own clock was set back
        self._last = (device_ns, stamp_ns)
        return stamp_ns


class _SupportingLine:
    """The line below the points (device time, offset) of a window, from the lowest of each of 60 stretches of it."""

    def __init__(self, window_ns: int, max_rate: float) -> None:
        self._window_ns, self._width_ns, self._max_rate = window_ns, max(window_ns // 60, 1), max_rate
        self._points: list[tuple[int, int]] = []
        self._rate = 0.0

    def __bool__(self) -> bool:
        return bool(self._points)

    def add(self, device_ns: int, offset_ns: int) -> None:
        newest_ns = max(device_ns, self._points[-1][0]) if self._points else device_ns
        kept = {t // self._width_ns: (t, o) for t, o in self._points if t >= newest_ns - self._window_ns}
        stretch = device_ns // self._width_ns
        if stretch not in kept or offset_ns < kept[stretch][1]:
            kept[stretch] = (device_ns, offset_ns)
        self._points = sorted(kept.values())
        self._rate = min(max(self._slope(), -self._max_rate), self._max_rate)

    def at(self, device_ns: int) -> float:
        """Height of the line [ns]."""
        return min(offset + self._rate * (device_ns - time) for time, offset in self._points)

    def scatter(self) -> float:
        """Median height of the points above the line [ns]; infinite from fewer than four."""
        if len(self._points) < 4:
            return math.inf
        now = self._points[-1][0]
        line = self.at(now)
        above = sorted(offset + self._rate * (now - time) - line for time, offset in self._points)
        return above[len(above) // 2]

    def _slope(self) -> float:
        """Of the supporting line that has the least mean distance to the points."""
        first_ns = self._points[0][0]
        if self._points[-1][0] - first_ns < NS:
            return 0.0
        middle = sum(time - first_ns for time, _ in self._points) / len(self._points) + first_ns
        hull: list[tuple[int, int]] = []
        for point in self._points:
            while len(hull) >= 2 and _is_above(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        right = next(index for index, point in enumerate(hull) if point[0] >= middle)
        (t0, o0), (t1, o1) = hull[right - 1], hull[right]
        return (o1 - o0) / (t1 - t0)


def _is_above(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
