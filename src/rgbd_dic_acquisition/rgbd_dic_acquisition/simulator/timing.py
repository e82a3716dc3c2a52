"""When sensors expose and their data arrive: free-running clocks with skew, phase, jitter, latency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..settings import Settings, setting


@dataclass(frozen=True)
class TimingSettings(Settings):
    """The clocks. Stamps are host time at exposure; a bag's log time is the stamp and the way of the data."""

    camera_rate_hz: float = setting(60.0, unit="Hz", low=0.1, high=1000.0, doc="images a second")
    tof_rate_hz: float = setting(20.0, unit="Hz", low=0.1, high=1000.0, doc="ToF frames a second")
    imu_rate_hz: float = setting(100.0, unit="Hz", low=0.1, high=2000.0, doc="attitudes a second")
    camera_skew_ppm: float = setting(38.0, unit="ppm", low=-1e4, high=1e4, doc="how slow the camera's clock is")
    tof_skew_ppm: float = setting(-65.0, unit="ppm", low=-1e4, high=1e4, doc="how slow the ToF clock is")
    tof_phase_s: float = setting(0.0073, unit="s", low=0.0, high=1.0, doc="first ToF frame after first image")
    jitter_s: float = setting(1e-4, unit="s", low=0.0, high=0.1, doc="standard deviation of an exposure's time")
    camera_latency_s: float = setting(0.009, unit="s", low=1e-4, high=10.0, doc="from exposure to arrival")
    tof_latency_s: float = setting(0.043, unit="s", low=1e-4, high=10.0, doc="from exposure to arrival")
    imu_latency_s: float = setting(0.004, unit="s", low=1e-4, high=10.0, doc="from exposure to arrival")


@dataclass(frozen=True)
class Ticks:
    """Moments of one sensor, (N,) int64 [ns since the start of the flight], both strictly increasing.

    stamp_delay_ns: a constant error of the stamps, which say that the exposure was later by this.
    """

    exposed_ns: NDArray[np.int64]
    arrived_ns: NDArray[np.int64]
    stamp_delay_ns: int = 0


def ticks(
    count: int,
    rate_hz: float,
    rng: np.random.Generator,
    *,
    phase_s: float = 0.0,
    skew_ppm: float = 0.0,
    jitter_s: float = 0.0,
    latency_s: float = 0.0,
) -> Ticks:
    """Exposures of a free-running sensor. Jitter stays below 1/4 of the period, latency varies by 20 %."""
    period_s = (1 + skew_ppm * 1e-6) / rate_hz
    limit_s = period_s / 4
    jitter = np.clip(jitter_s * rng.standard_normal(count), -limit_s, limit_s)
    exposed_s = limit_s + phase_s + period_s * np.arange(count) + jitter
    delay_s = latency_s + min(0.2 * latency_s, limit_s) * rng.random(count)
    return Ticks(np.rint(exposed_s * 1e9).astype(np.int64), np.rint((exposed_s + delay_s) * 1e9).astype(np.int64))
