"""The 3D DIC system that the thesis compares with (4.1.2): slow, exact, on a clock of its own; as its user's CSV."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..settings import Settings, setting
from .motion import CrackState

Array = NDArray[np.float64]

HEADER = "time_s,opening_mm,sliding_mm,out_of_plane_mm"


@dataclass(frozen=True)
class StereoSettings(Settings):
    """The reference system."""

    rate_hz: float = setting(5.0, unit="Hz", low=0.1, high=100.0, doc="images a second (thesis 4.1.2)")
    delay_s: float = setting(0.3, unit="s", low=-60.0, high=60.0, doc="about how late its history is")
    delay_spread_s: float = setting(0.05, unit="s", low=0.0, high=10.0, doc="the true delay is up to this from that")
    noise_m: float = setting(3e-6, unit="m", low=0.0, high=1e-2, doc="of opening and sliding; out of plane thrice it")


class StereoReference:
    """Openings in time, as measured.

    Attributes:
        delay_s: the true delay: what happened at t of the flight is in the row of t + delay_s.
        time_s: (N,) times of the rows [s]; 0 is the start of the flight.
        measured_m: (N, 3) opening, sliding, out of plane [m].
    """

    def __init__(
        self,
        settings: StereoSettings,
        crack: Callable[[float], CrackState],
        duration_s: float,
        rng: np.random.Generator,
    ) -> None:
        s = settings
        self.delay_s = float(s.delay_s + rng.uniform(-s.delay_spread_s, s.delay_spread_s))
        first = rng.uniform(0, 1 / s.rate_hz)
        moments = np.arange(first, duration_s, 1 / s.rate_hz)
        states = [crack(t) for t in moments]
        exact = np.array([(c.opening_m, c.sliding_m, c.out_of_plane_m) for c in states]).reshape(-1, 3)
        self.measured_m = exact + s.noise_m * np.array([1.0, 1.0, 3.0]) * rng.standard_normal(exact.shape)
        self.time_s = moments + self.delay_s

    def save(self, path: Path) -> None:
        """As CSV, in millimetres."""
        rows = [
            f"{time:.4f}," + ",".join(f"{1e3 * value:.6f}" for value in values)
            for time, values in zip(self.time_s, self.measured_m, strict=True)
        ]
        path.write_text("\n".join([HEADER, *rows]) + "\n")
