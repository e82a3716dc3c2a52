"""Device time to host time from nothing but the arrival of what a device sends.

Each sample says: host time of an event = device time + offset, and arrival - device time = offset +
delivery. The delivery is never negative, often nearly constant and at times very long; the rates of two
oscillators differ by a nearly constant amount. So the offset is the line that supports the cloud of
(device time, arrival - device time) from below. The shortest delivery itself cannot be seen from one side;
`fixed_delay_ns` takes it off where it is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from .errors import SettingsError

NS = 1_000_000_000
# A device time this far back is a restart of the device, not a packet that was overtaken [ns].
RESTART_NS = 1 * NS


@dataclass(frozen=True)
class HostStamp:
    """Host time of an event on the device.

    Attributes:
        stamp_ns: host time [ns since the epoch]; later for a later device time, never after the arrival of
            its own sample, and without jumps back while the estimate converges.
        uncertainty_ns: standard uncertainty of it without the shortest delivery [ns]; infinite until known.
    """

    stamp_ns: int
    uncertainty_ns: float


@dataclass
class HostClock:
    """Follows the offset of one device's clock over a sliding window.

    Attributes:
        window_ns: how far back samples count [ns of device time].
        resolution_ns: step of the device's time stamps [ns]; they are taken to be cut off, not rounded.
        fixed_delay_ns: shortest time from the event to its arrival [ns], if known.
        max_rate: largest difference in rate of the two clocks, without unit; the window must see a second of
            it before a rate is believed at all.
        restarts: how often the device's time has jumped back, and the estimate begun anew.
    """

    window_ns: int = 30 * NS
    resolution_ns: int = 1
    fixed_delay_ns: int = 0
    max_rate: float = 500e-6
    restarts: int = 0
    _bins: list[tuple[int, int]] = field(default_factory=list, repr=False)
    _newest_ns: int | None = field(default=None, repr=False)
    _last: tuple[int, int] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.window_ns < NS or self.resolution_ns < 1:
            raise SettingsError(
                f"HostClock: window_ns = {self.window_ns} must be at least {NS}, resolution_ns = "
                f"{self.resolution_ns} at least 1"
            )

    def stamp(self, device_ns: int, arrival_ns: int) -> HostStamp:
        """Take a sample into account and map its device time to host time."""
        if self._newest_ns is not None and device_ns < self._newest_ns - RESTART_NS:
            self._bins, self._newest_ns, self._last = [], None, None
            self.restarts += 1
        newest_ns = max(device_ns, self._newest_ns or device_ns)
        self._newest_ns = newest_ns
        self._insert(device_ns, arrival_ns - device_ns)
        rate = self._rate()
        offset_ns = self._offset(device_ns, rate)
        # Time that was cut off is half a step early on average; the envelope follows those that are least so.
        stamp_ns = device_ns + math.floor(offset_ns) + self.resolution_ns // 2 - self.fixed_delay_ns
        return HostStamp(self._monotone(device_ns, stamp_ns, arrival_ns), self._uncertainty(rate))

    def _insert(self, device_ns: int, offset_ns: int) -> None:
        """Keep the lowest point of each of about 60 stretches of the window."""
        width = max(self.window_ns // 60, 1)
        first_kept = self._newest_ns - self.window_ns
        bins = {time // width: (time, offset) for time, offset in self._bins if time >= first_kept}
        index = device_ns // width
        if index not in bins or offset_ns < bins[index][1]:
            bins[index] = (device_ns, offset_ns)
        self._bins = sorted(bins.values())

    def _rate(self) -> float:
        """Slope of the supporting line that has the least mean distance to the points."""
        if self._bins[-1][0] - self._bins[0][0] < NS:
            return 0.0
        middle = sum(time - self._bins[0][0] for time, _ in self._bins) / len(self._bins) + self._bins[0][0]
        hull: list[tuple[int, int]] = []
        for point in self._bins:
            while len(hull) >= 2 and _is_above(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        right = next(index for index, point in enumerate(hull) if point[0] >= middle)
        (t0, o0), (t1, o1) = hull[right - 1], hull[right]
        return min(max((o1 - o0) / (t1 - t0), -self.max_rate), self.max_rate)

    def _offset(self, device_ns: int, rate: float) -> float:
        return min(offset + rate * (device_ns - time) for time, offset in self._bins)

    def _uncertainty(self, rate: float) -> float:
        """From how far the lowest points of the stretches lie above the line, and the device's resolution."""
        if len(self._bins) < 4:
            return math.inf
        now = self._bins[-1][0]
        line = self._offset(now, rate)
        above = sorted(offset + rate * (now - time) - line for time, offset in self._bins)
        return math.hypot(above[len(above) // 2], self.resolution_ns / math.sqrt(12))

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


def _is_above(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
