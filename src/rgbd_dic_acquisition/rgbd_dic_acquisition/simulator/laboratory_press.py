"""The hydraulic press: a sinusoidal cycle is commanded, and the piston does not follow it well (thesis 4.1.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ..settings import Settings, setting

Array = NDArray[np.float64]

STEP_S = 0.002  # of the integration


@dataclass(frozen=True)
class PressSettings(Settings):
    """The command, and how its controller falls short of it."""

    stroke_m: float = setting(0.003, unit="m", low=0.0, high=0.1, doc="commanded, from peak to peak")
    frequency_hz: float = setting(0.5, unit="Hz", low=0.01, high=10.0, doc="of the commanded cycle")
    still_s: float = setting(0.3, unit="s", low=0.0, high=1e4, doc="time without load at the start")
    gain_per_s: float = setting(9.0, unit="1/s", low=0.1, high=1e3, doc="speed for each metre that the piston is off")
    speed_m_s: float = setting(0.0045, unit="m/s", low=1e-6, high=1.0, doc="highest speed of the piston")
    dead_band_m: float = setting(0.00015, unit="m", low=0.0, high=0.01, doc="error up to which the valve stays shut")
    valve_s: float = setting(0.04, unit="s", low=0.005, high=1.0, doc="time constant of the valve")
    clip: float = setting(0.95, low=0.0, high=1.0, doc="part of the stroke at which the command is cut off")


class Press:
    """Stroke of the piston over time.

    The command is r = stroke (1 - cos 2 pi f t) / 2, cut off at `clip`. The valve's speed v follows the controller's,
    valve_s dv/dt = u - v with u = gain (r - q) limited to the highest speed, and 0 within the dead band, so that the
    piston lags, rounds and dwells; dq/dt = v. The cubic spline through the integrated steps *is* the stroke.
    """

    def __init__(self, settings: PressSettings, duration_s: float) -> None:
        self.settings, s = settings, settings
        times = STEP_S * np.arange(int(np.ceil(max(duration_s - s.still_s, 0.0) / STEP_S)) + 1000)
        command = self.command(times + s.still_s)
        stroke, speed = np.zeros_like(times), 0.0
        for i in range(1, len(times)):
            off = command[i - 1] - stroke[i - 1]
            wanted = np.clip(s.gain_per_s * off, -s.speed_m_s, s.speed_m_s) if abs(off) > s.dead_band_m else 0.0
            speed += STEP_S / s.valve_s * (wanted - speed)
            stroke[i] = stroke[i - 1] + STEP_S * speed
        self._last_s = float(times[-1])
        self._stroke = CubicSpline(times, stroke, bc_type="clamped")

    def command(self, time_s: Array | float) -> Array:
        """What the piston should do [m]."""
        s = self.settings
        phase = 2 * np.pi * s.frequency_hz * np.maximum(np.asarray(time_s, float) - s.still_s, 0.0)
        return s.stroke_m * np.minimum(0.5 * (1 - np.cos(phase)), s.clip)

    def stroke(self, time_s: Array | float) -> Array:
        """What it does [m]; exactly 0 until the load begins."""
        return self._stroke(np.clip(np.asarray(time_s, float) - self.settings.still_s, 0.0, self._last_s))
