"""Checks of what the autopilot sends."""

from __future__ import annotations

import numpy as np

from .finding import Finding, Level, graded
from .listening import HeardAutopilot

LEAST_HZ, ENOUGH_HZ = 5.0, 20.0
CLOCK_NS = 5_000_000


def attitude(heard: HeardAutopilot) -> Finding:
    """Whether attitude comes often enough."""
    name, stamps = "attitude", np.array(heard.stamps_ns)
    if len(stamps) < 2:
        remedy = "link.url, wiring, baud rate, the autopilot's settings of this port (docs/payload.md)"
        return Finding(name, Level.FAIL, heard.problem or "no attitude", remedy)
    rate_hz = (len(stamps) - 1) * 1e9 / (stamps[-1] - stamps[0])
    remedy = "link.attitude_rate_hz: 50"
    return graded(name, f"{rate_hz:.1f} Hz", remedy, rate_hz >= ENOUGH_HZ, rate_hz >= LEAST_HZ)


def timesync(heard: HeardAutopilot) -> Finding:
    """Whether the autopilot's stamps are in the computer's time."""
    name = "TIMESYNC"
    if not heard.is_synchronised:
        text = heard.problem or "not answered yet: stamps go by the arrival of messages"
        return Finding(name, Level.WARN, text, "docs/payload.md, Time: firmware, router, faster link")
    text = f"stamps to {heard.uncertainty_ns * 1e-6:.1f} ms"
    return graded(name, text, "a faster link, less traffic", heard.uncertainty_ns <= CLOCK_NS, bearable=True)
