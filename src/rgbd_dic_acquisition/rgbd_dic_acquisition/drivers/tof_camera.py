"""A real ToF camera as a source of depth frames, through whichever library reads it."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from ..calibration import Camera
from ..clock import HostClock
from ..errors import DeviceError, ImageError
from ..sources import DepthFrame
from .tof_components import Coordinates, depth_frame
from .tof_device import Grab, TofDevice, device_class
from .tof_settings import TofSettings
from .tof_setup import coordinates, disagreement_px, intrinsics, latch, set_up

# A device that delivers nothing but failed buffers for this long is worth opening again [s].
USELESS_S = 3.0
# The clock of a device that has a latch is latched this often [s].
LATCH_S = 2.0
FIRST_LATCHES = 8  # at the first frame; the narrowest counts, so one that was held up does no harm
# A latched clock is not that of the frames if it says that one is on its way for longer than this [ns].
PLAUSIBLE_NS = 1_000_000_000
# How long the device's clock is watched before it is told whether it counts nanoseconds [ns].
MEASURE_RATE_NS = 200_000_000
# How late a frame may be then, the first or the latest, as the computer is busy [ns].
BACKLOG_NS = 500_000_000
POINTS_OFF = "points off the intrinsics [px]"


class TofCamera:
    """The device that the settings name; `open` may be called again after `close`. See TofSource.

    Attributes:
        camera: the intrinsics that the device tells; None before it is open, or if it tells none.
        counts: buffers by what became of them: "frames", "failed", and "lost" by the device's own count.
        failure: what was wrong with the last that failed.
        told: the device, where its stamps come from, and what it does not do of what was asked.
        period_s: time between frames.
        uncertainty_ns: standard uncertainty of the latest stamp [ns]; infinite until known, or without a clock.
    """

    frame_id = "tof_optical_frame"

    def __init__(
        self, library: str, settings: TofSettings, connect: Callable[[TofSettings], TofDevice] | None = None
    ) -> None:
        """
        Raises:
            DeviceError: the library is not installed.
        """
        self.camera: Camera | None = None
        self.counts: Counter[str] = Counter(frames=0, failed=0, lost=0)
        self.failure = ""
        self.told: dict[str, str] = {}
        self.period_s = self.uncertainty_ns = math.inf
        self._settings = settings
        self._connect = connect or device_class(library)
        self._device: TofDevice | None = None
        self._last_stamp_ns = 0

    def open(self) -> None:
        """Connect, set up and start.

        Raises:
            DeviceError: the device is not there.
            SettingsError: it refuses a setting.
        """
        self.close()
        device = self._connect(self._settings)
        try:
            lacking = set_up(device.features, self._settings)
            self._coordinates: Coordinates | None = coordinates(device.features)
            self.camera = intrinsics(device.features)
            rate_hz = self._settings.frame_rate_hz or device.features.get("AcquisitionFrameRate")
            self.period_s = 1 / float(rate_hz) if rate_hz else 1.0
            device.start()
        except BaseException:
            device.close()
            raise
        self.told = {"device": device.name, **({"not done": "; ".join(lacking)} if lacking else {})}
        self._clock = HostClock()
        self._latch_works = self._is_clock = True
        self._first: tuple[int, int] | None = None
        self._number: int | None = None
        self._good_at = time.monotonic()
        self._latch_at = -math.inf
        self._device = device

    def close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def __enter__(self) -> TofCamera:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(self, timeout_s: float) -> DepthFrame | None:
        """The next good frame, or None if none came in time (0 or less does not wait).

        Raises:
            DeviceError: the device is gone, or delivers only buffers that failed.
        """
        device = self._device
        if device is None:
            raise DeviceError("the ToF camera is not open: call open() first")
        grab = device.grab(timeout_s)
        if grab is None:
            return None
        arrival_ns, now = time.time_ns(), time.monotonic()
        frame = self._frame(device, grab, arrival_ns, now)
        if frame is not None:
            self._good_at = now
        elif now - self._good_at > max(USELESS_S, 3 * self.period_s):
            raise DeviceError(f"{device.name} sends no good buffer: {self.failure}")
        return frame

    def _frame(self, device: TofDevice, grab: Grab, arrival_ns: int, now: float) -> DepthFrame | None:
        self._count_lost(grab.number)
        if grab.failure:
            return self._fail(grab.failure)
        if self._latch_works and now - self._latch_at > LATCH_S:
            for _ in range(1 if math.isfinite(self._latch_at) else FIRST_LATCHES):
                if self._latch_works:
                    self._latch(device, grab, arrival_ns)
            self._latch_at = now
        stamp_ns = self._stamp(grab, arrival_ns)
        if stamp_ns <= self._last_stamp_ns:
            return self._fail("its stamp is not later than that of the frame before")
        limits_m = (self._settings.depth_min_m, self._settings.depth_max_m)
        try:
            frame = depth_frame(stamp_ns, grab.components, self._coordinates, limits_m)
        except ImageError as error:
            return self._fail(str(error))
        if self.camera is not None and frame.points_m is not None and POINTS_OFF not in self.told:
            across, down = disagreement_px(self.camera, frame.points_m)
            self.told[POINTS_OFF] = f"{across:.2f}, {down:.2f}"
        self._last_stamp_ns = stamp_ns
        self.counts["frames"] += 1
        return replace(frame, device_ns=grab.device_ns)

    def _fail(self, reason: str) -> None:
        self.failure = reason
        self.counts["failed"] += 1

    def _count_lost(self, number: int | None) -> None:
        if self._number is not None:
            number = self._number + 1 if number is None else number
            self.counts["lost"] += max(number - self._number - 1, 0)
        self._number = number

    def _latch(self, device: TofDevice, grab: Grab, arrival_ns: int) -> None:
        """Compare the clocks, if the device can, and if it latches the clock that its frames are stamped by."""
        latched = latch(device.features) if grab.device_ns is not None else None
        if latched is not None:
            device_ns, before_ns, after_ns = latched
            frame_ns = grab.device_ns + (before_ns + after_ns) // 2 - device_ns
            if 0 <= arrival_ns - frame_ns + (after_ns - before_ns) < PLAUSIBLE_NS:
                self._clock.latch(device_ns, before_ns, after_ns)
                return
        self._latch_works = False

    def _stamp(self, grab: Grab, arrival_ns: int) -> int:
        """Host time of the frame."""
        if grab.device_ns is None or not self._counts_nanoseconds(grab.device_ns, arrival_ns):
            self.told["clock"] = f"none{'' if grab.device_ns is None else ' in nanoseconds'}: stamps are the arrival"
            self.uncertainty_ns = math.inf
            return arrival_ns
        host = self._clock.stamp(grab.device_ns, arrival_ns)
        self.uncertainty_ns = host.uncertainty_ns
        source = "latches" if self._clock.latched else "arrivals"
        self.told["clock"] = f"by {source}, to {host.uncertainty_ns * 1e-6:.3f} ms"
        return host.stamp_ns

    def _counts_nanoseconds(self, device_ns: int, arrival_ns: int) -> bool:
        """Whether the device's clock runs about as fast as ours; once it does not, it is not asked again."""
        first_device_ns, first_arrival_ns = self._first = self._first or (device_ns, arrival_ns)
        passed_ns = arrival_ns - first_arrival_ns
        if self._is_clock and MEASURE_RATE_NS < passed_ns < 10 * MEASURE_RATE_NS:
            counted_ns = device_ns - first_device_ns
            self._is_clock = (passed_ns - BACKLOG_NS) / 2 < counted_ns < 2 * (passed_ns + BACKLOG_NS)
        return self._is_clock
