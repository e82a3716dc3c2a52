"""The simulated sensors as live sources: the flight goes there and back for ever, by the host's clock.

Both take the scene's time from the host's clock alone, so that a camera and a ToF sensor in two processes
look at the same moment of the same flight.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..sources import DepthFrame, ImageFrame
from .flight import CAMERA_FRAME, TOF_FRAME, Flight, FlightSettings
from .motion import CrackState, Pose

Progress = Callable[[int, int], None]


def scene_time_s(stamp_ns: int, settings: FlightSettings) -> float:
    """Host time -> time of the flight: forwards for its duration, then backwards, and so on."""
    half_ns = _images_in(settings) * _period_ns(settings.timing.camera_rate_hz)
    phase_ns = stamp_ns % (2 * half_ns)
    return min(phase_ns, 2 * half_ns - phase_ns) * 1e-9


def there_and_back(number: int, count: int) -> int:
    """Which of `count` images (at least two) is the one of this number."""
    last = count - 1
    step = number % (2 * last)
    return min(step, 2 * last - step)


def _images_in(settings: FlightSettings) -> int:
    return max(1, round(settings.duration_s * settings.timing.camera_rate_hz))


def _period_ns(rate_hz: float) -> int:
    return round(1e9 / rate_hz)


class _SimulatedSource:
    """Frames on a regular grid of host time; a frame that nobody was there to read in time is lost."""

    uncertainty_ns = 0.0  # of a stamp

    def __init__(self, settings: FlightSettings, rate_hz: float, phase_s: float) -> None:
        self.settings = settings
        self._period_ns = _period_ns(rate_hz)
        self._phase_ns = round(phase_s * 1e9)
        self._flight: Flight | None = None
        self._next = 0

    @property
    def flight(self) -> Flight:
        if self._flight is None:
            self._flight = Flight(self.settings)
        return self._flight

    def truth(self, stamp_ns: int) -> tuple[Pose, CrackState]:
        """T_camera_panel and the crack at a host time."""
        time_s = scene_time_s(stamp_ns, self.settings)
        return self.flight.pose(time_s), self.flight.crack(time_s)

    def close(self) -> None:
        """Nothing to let go of."""

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait(self, timeout_s: float) -> tuple[int, int] | None:
        """(number, stamp) of the next exposure once it is over; None if that is later than the timeout."""
        now_ns = time.time_ns()
        latest = (now_ns - self._phase_ns) // self._period_ns
        number = max(self._next, latest)
        stamp_ns = number * self._period_ns + self._phase_ns
        remaining_s = (stamp_ns - now_ns) * 1e-9
        if remaining_s > max(timeout_s, 0.0):
            time.sleep(max(timeout_s, 0.0))
            return None
        if remaining_s > 0:
            time.sleep(remaining_s)
        self._next = number + 1
        return number, stamp_ns


class SimulatedCamera(_SimulatedSource):
    """A greyscale camera that plays a flight. `open` renders the loop once, so that any rate can be kept up.

    Args:
        settings: the flight; its duration is half of the loop, its camera_rate_hz the rate.
        progress: called with (images done, images in all) while the loop is rendered.
    """

    frame_id = CAMERA_FRAME
    period_s = math.inf  # it is never silent: who waits, waits for the right moment

    def __init__(self, settings: FlightSettings, progress: Progress | None = None) -> None:
        super().__init__(settings, settings.timing.camera_rate_hz, 0.0)
        self.counts: Counter[str] = Counter()
        self.told: dict[str, str] = {}
        self._progress = progress
        self._images: list[NDArray[np.uint8]] = []
        self.camera = self.flight.calibration.camera

    def open(self) -> None:
        count = _images_in(self.settings) + 1
        for index in range(len(self._images), count):
            self._images.append(self.flight.image(index * self._period_ns * 1e-9, index))
            if self._progress is not None:
                self._progress(index + 1, count)

    def __enter__(self) -> SimulatedCamera:
        self.open()
        return self

    def read(self, timeout_s: float) -> ImageFrame | None:
        due = self._wait(timeout_s)
        if due is None:
            return None
        number, stamp_ns = due
        return ImageFrame(stamp_ns, self._images[there_and_back(number, len(self._images))])


class SimulatedTof(_SimulatedSource):
    """A ToF sensor that plays the same flight, rendered as it goes."""

    frame_id = TOF_FRAME
    period_s = math.inf  # it is never silent: who waits, waits for the right moment

    def __init__(self, settings: FlightSettings) -> None:
        super().__init__(settings, settings.timing.tof_rate_hz, settings.timing.tof_phase_s)
        self.counts: Counter[str] = Counter()
        self.told: dict[str, str] = {}
        self.camera = self.flight.tof_model.camera

    def open(self) -> None:
        """Nothing to connect to."""

    def __enter__(self) -> SimulatedTof:
        self.open()
        return self

    def read(self, timeout_s: float) -> DepthFrame | None:
        due = self._wait(timeout_s)
        if due is None:
            return None
        number, stamp_ns = due
        frame = self.flight.depth(scene_time_s(stamp_ns, self.settings), number)
        return DepthFrame(stamp_ns, frame.depth_m.astype(np.float32), frame.intensity, frame.confidence)
