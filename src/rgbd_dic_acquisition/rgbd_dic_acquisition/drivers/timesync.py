"""Offset between host and autopilot by exchange in both directions: TIMESYNC, filtered as mavros and PX4 do it.

The host sends its time `ts1`, the autopilot sends that back with its own time `tc1`. On arrival

    offset = (ts1 + arrival) / 2 - tc1,      host time = autopilot's time + offset,

is right to within half the round trip, whatever the delay of the link. Offset and drift are smoothed
exponentially (Holt), with gains that fall from a first to a last value over a number of samples; slow replies and
lone outliers are left aside, and a lasting jump begins anew (mavros, plugins/sys_time.cpp; PX4, timesync/Timesync.hpp,
whose numbers these are). Two things differ: the first samples are averaged evenly, so that the very first weighs no
more than the others, and what is slow is told by the fastest of the latest replies, so that a reply that was held up
on one way alone, and is off by half of that, does not count on a fast link either. One that is by far faster than all
before makes them forgotten.
"""

from __future__ import annotations

import math
from collections import deque

from ..clock import NS

FIRST_GAIN, LAST_GAIN = 0.05, 0.003  # of the offset, and of its rate
GAIN_WINDOW = 500  # samples from the first gain to the last
SETTLED = 5  # samples from which on the offset is used
DRIFT_SEEN = 20  # samples from which on there is a drift
MAX_DEVIATION_NS = NS // 10
MAX_DEVIATIONS = 5  # in a row; more are a jump
RECENT_NS = 5 * NS  # of which the fastest reply is the measure
SLACK_NS, SLACK = 500_000, 0.5  # what a reply that counts may take more than that, the larger of both
SHORTEST_STEP_S = 0.05  # of the estimate of the drift
EXPIRES_NS = 10 * NS  # after this long without a reply the drift has made the offset worthless
UNANSWERED_NS = 2 * NS
REMEMBERED = 100  # requests that may still be answered


class Timesync:
    """The exchange with one autopilot.

    Attributes:
        jumps: how often the offset was found to have jumped.
        round_trip_ns: of the fastest of the latest replies [ns]; NaN before the first.
    """

    def __init__(self, max_round_trip_ns: int) -> None:
        """Replies slower than this are never used."""
        self.jumps = 0
        self.round_trip_ns = math.nan
        self._max_round_trip_ns = max_round_trip_ns
        self._requested: deque[int] = deque(maxlen=REMEMBERED)
        self._round_trips: deque[tuple[int, int]] = deque()  # arrival, round trip
        self._asking_since_ns: int | None = None  # without an answer
        self._asked_ns = 0
        self.reset()

    def reset(self) -> None:
        """Forget the offset: the autopilot was restarted, or one of the clocks was set."""
        self._requested.clear()
        self._round_trips.clear()
        self._samples = self._averaged = self._deviations = 0
        self._slowest_ns = 0  # of those that the offset rests on
        self._base_ns = self._updated_ns = 0
        self._offset_ns = self._rate = 0.0  # offset less its first value [ns]; its change per time

    def request(self, now_ns: int) -> int:
        """`ts1` of a request that is sent now; its `tc1` is 0."""
        if self._asking_since_ns is None or now_ns - self._asked_ns > NS:  # it is asked again after a pause
            self._asking_since_ns = now_ns
        self._asked_ns = now_ns
        self._requested.append(now_ns)
        return now_ns

    def reply(self, tc1_ns: int, ts1_ns: int, arrival_ns: int) -> bool:
        """Take a reply; whether it was used. One to a request of somebody else never is."""
        if tc1_ns <= 0 or ts1_ns not in self._requested:
            return False
        self._requested.remove(ts1_ns)
        self._asking_since_ns = None
        round_trip_ns = arrival_ns - ts1_ns
        if round_trip_ns < 0:  # the host's clock was set back
            return False
        self._round_trips.append((arrival_ns, round_trip_ns))
        while self._round_trips[0][0] < arrival_ns - RECENT_NS:
            self._round_trips.popleft()
        fastest_ns = min(round_trip for _, round_trip in self._round_trips)
        self.round_trip_ns = float(fastest_ns)
        if round_trip_ns > min(_with_slack(fastest_ns), self._max_round_trip_ns):
            return False
        return self._update((ts1_ns + arrival_ns) // 2 - tc1_ns, round_trip_ns, arrival_ns)

    def offset_ns(self, now_ns: int) -> int | None:
        """What to add to the autopilot's time [ns]; None while it is not known well enough."""
        age_ns = now_ns - self._updated_ns
        if self._samples < SETTLED or not 0 <= age_ns <= EXPIRES_NS:
            return None
        return self._base_ns + round(self._offset_ns + self._rate * age_ns)

    @property
    def uncertainty_ns(self) -> float:
        """Standard uncertainty of the offset [ns]: how the round trips divide into their two ways is not known."""
        return self._slowest_ns / 2 / math.sqrt(3)

    @property
    def problem(self) -> str:
        """Why there may be no offset, in words; empty if nothing is known against it."""
        if self._asking_since_ns is not None and self._asked_ns - self._asking_since_ns > UNANSWERED_NS:
            return "TIMESYNC is not answered"
        if self.round_trip_ns > self._max_round_trip_ns:
            return (
                f"TIMESYNC takes {self.round_trip_ns * 1e-6:.1f} ms there and back, more than the "
                f"{self._max_round_trip_ns * 1e-6:g} ms that are allowed: take a faster link, or load it less"
            )
        return ""

    def _update(self, offset_ns: int, round_trip_ns: int, arrival_ns: int) -> bool:
        if self._samples == 0:
            self._base_ns = offset_ns
        step_ns = arrival_ns - self._updated_ns if self._samples else 0
        predicted_ns = self._offset_ns + self._rate * step_ns
        error_ns = offset_ns - self._base_ns - predicted_ns
        if self._samples >= SETTLED and abs(error_ns) > MAX_DEVIATION_NS:
            self._deviations += 1
            if self._deviations > MAX_DEVIATIONS:
                self.jumps += 1
                self.reset()
            return False
        if 2 * _with_slack(round_trip_ns) < self._slowest_ns:
            self._averaged = self._slowest_ns = 0
        self._slowest_ns = max(self._slowest_ns, round_trip_ns)
        gain = _gain(self._averaged)
        alpha = max(gain, 1 / (self._averaged + 1))
        self._offset_ns = predicted_ns + alpha * error_ns
        if self._averaged >= DRIFT_SEEN:
            self._rate += gain * alpha * error_ns / max(step_ns, SHORTEST_STEP_S * NS)
        self._updated_ns = arrival_ns
        self._samples += 1
        self._averaged += 1
        self._deviations = 0
        return True


def _with_slack(round_trip_ns: int) -> float:
    return round_trip_ns + max(SLACK_NS, SLACK * round_trip_ns)


def _gain(samples: int) -> float:
    if samples >= GAIN_WINDOW:
        return LAST_GAIN
    progress = samples / GAIN_WINDOW
    part = 1 - math.exp(0.5 * (1 - 1 / (1 - progress)))
    return part * LAST_GAIN + (1 - part) * FIRST_GAIN
