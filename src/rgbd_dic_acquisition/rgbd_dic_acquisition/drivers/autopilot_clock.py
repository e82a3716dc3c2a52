"""Host time of what an autopilot stamps with its time since boot.

`HostClock` follows that clock by the arrival of its messages; how long even the fastest of them was on its way, it
cannot see. `Timesync` can, and what it says is taken off.
"""

from __future__ import annotations

import math

from ..clock import NS, RESTART_NS, HostClock, HostStamp
from .timesync import Timesync

RESOLUTION_NS = 1_000_000  # of time_boot_ms
LONGEST_DELIVERY_NS = 1 * NS  # of the fastest message; if it seems longer, the two times are not of one clock
EARLIEST_DELIVERY_NS = -20_000_000  # what noise explains: nothing arrives before it was sent
SLEW = 0.05  # change of the delivery that is taken off, per time
SILENCE_NS = 1 * NS  # in which an autopilot can have been restarted


class AutopilotClock:
    """Maps the time since boot of one autopilot to host time.

    Attributes:
        timesync: the exchange; requests and replies go to it directly.
        restarts: how often the autopilot was found to have been restarted.
        is_synchronised: whether the latest stamp rests on TIMESYNC, not on the arrival of messages alone.
        delivery_ns: how long the fastest message is on its way [ns], as far as it is taken off yet.
        problem: what is wrong with the exchange, in words, or empty.
    """

    def __init__(self, max_round_trip_ns: int) -> None:
        self.timesync = Timesync(max_round_trip_ns)
        self.restarts = 0
        self._begin()

    def stamp(self, boot_ms: int, arrival_ns: int) -> HostStamp:
        """Host time of an event, from the autopilot's time since boot and the arrival of the message about it.

        It increases with the autopilot's time, is never after the arrival, and does not step while it converges; what
        it is still late by then is part of its uncertainty.
        """
        device_ns = boot_ms * 1_000_000
        if self._was_restarted(device_ns, arrival_ns):
            self.restarts += 1
            self._begin()
        elif self.timesync.jumps != self._jumps:  # the host's clock was set
            self._begin()
        stamp = self._envelope.stamp(device_ns, arrival_ns)
        newest_ns, _ = self._newest or (device_ns, arrival_ns)
        self._newest = max(self._newest or (0, 0), (device_ns, arrival_ns))
        wanted_ns = self._measured_delivery_ns(device_ns, arrival_ns, stamp)
        most_ns = round(SLEW * max(0, device_ns - newest_ns))
        self.delivery_ns += min(max(wanted_ns - self.delivery_ns, -most_ns), most_ns)
        if not self.is_synchronised:
            return HostStamp(stamp.stamp_ns - self.delivery_ns, stamp.uncertainty_ns)
        not_taken_off_ns = wanted_ns - self.delivery_ns
        uncertainty_ns = math.hypot(self.timesync.uncertainty_ns, RESOLUTION_NS / math.sqrt(12), not_taken_off_ns)
        return HostStamp(stamp.stamp_ns - self.delivery_ns, uncertainty_ns)

    def _begin(self) -> None:
        self.timesync.reset()
        self._jumps = self.timesync.jumps
        self._envelope = HostClock(resolution_ns=RESOLUTION_NS)
        self._newest: tuple[int, int] | None = None  # device time and arrival
        self.is_synchronised = False
        self.delivery_ns = 0
        self.problem = ""

    def _was_restarted(self, device_ns: int, arrival_ns: int) -> bool:
        """The time since boot went back, or is shorter than a silence that it has not gone on through."""
        if self._newest is None:
            return False
        passed_ns, silence_ns = device_ns - self._newest[0], arrival_ns - self._newest[1]
        return passed_ns < -RESTART_NS or (silence_ns > SILENCE_NS + max(passed_ns, 0) and device_ns < silence_ns)

    def _measured_delivery_ns(self, device_ns: int, arrival_ns: int, stamp: HostStamp) -> int:
        """Of the fastest message, by TIMESYNC [ns]; 0 without it."""
        offset_ns = self.timesync.offset_ns(arrival_ns)
        self.problem = self.timesync.problem
        self.is_synchronised = offset_ns is not None
        if offset_ns is None:
            return 0
        delivery_ns = stamp.stamp_ns - (device_ns + RESOLUTION_NS // 2 + offset_ns)
        if EARLIEST_DELIVERY_NS <= delivery_ns <= LONGEST_DELIVERY_NS:
            return max(0, delivery_ns)
        self.is_synchronised = False
        self.problem = (
            f"TIMESYNC of the autopilot and its time since boot are {delivery_ns * 1e-9:.3f} s apart: stamps go by the "
            "arrival of messages; update its firmware, or switch TIMESYNC off with link.timesync_rate_hz"
        )
        return 0
