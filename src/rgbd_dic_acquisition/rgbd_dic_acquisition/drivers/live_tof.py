"""A real ToF camera as a source of depth frames that outlives the camera's failures."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet

from ..calibration import Camera
from ..clock import HostClock
from ..errors import DeviceError, ImageError
from ..sources import DepthFrame
from .tof_components import Coordinates, depth_frame
from .tof_device import Grab, TofDevice, device_class
from .tof_features import TofSettings, coordinates, intrinsics, set_up

# A device counts as lost after this many frame periods and this long without a buffer.
SILENT_FRAMES, SILENT_S = 3, 0.2
# It is opened again too when it has delivered nothing but failed buffers for this long [s].
USELESS_S = 3.0
RETRY_S = 0.5
# How long a failed buffer is told of [s].
TELL_S = 2.0
SLOWEST_HZ = 1.0


class LiveTof:
    """Opens the device beside the caller, and again whenever it is lost; `read` never waits longer than told.

    Attributes:
        camera: the intrinsics that the device tells; None before it is open, or if it tells none.
        counts: buffers by what became of them: "frames", "failed", "lost" (by the device's own count); and how
            often the device was "opened".
        problem: why no frames come, or some are missing, in words; empty while all is well.
        told: the name of the device, where its stamps come from and their standard uncertainty, warnings.
    """

    frame_id = "tof_optical_frame"

    def __init__(
        self, library: str, settings: TofSettings, connect: Callable[[TofSettings], TofDevice] | None = None
    ) -> None:
        self.camera: Camera | None = None
        self.counts: Counter[str] = Counter()
        self.told: dict[str, str] = {}
        self.warnings: list[str] = []
        self._library, self._settings, self._connect = library, settings, connect
        self._beside = ThreadPoolExecutor(1, "tof")
        self._opening: Future[TofDevice] | None = None
        self._device: TofDevice | None = None
        self._lost: TofDevice | None = None
        self._problem = "the device is being opened"
        self._retry_at = self._failed_at = -math.inf
        self._last_stamp_ns = 0

    @property
    def problem(self) -> str:
        if self._device is not None and time.monotonic() - self._failed_at < TELL_S:
            return f"{self.counts['failed']} buffers failed so far, the last: {self._failure}"
        return self._problem

    def open(self) -> None:
        """Begin to open the device; `read` tells how it goes.

        Raises:
            DeviceError: the library that reads it is not installed.
        """
        self._connect = self._connect or device_class(self._library)

    def close(self) -> None:
        """Let go of the device."""
        self._beside.submit(self._let_go)
        self._beside.shutdown()

    def __enter__(self) -> LiveTof:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(self, timeout_s: float) -> DepthFrame | None:
        """The next frame, or None if none came in time (0 or less does not wait)."""
        if self._device is None:
            self._go_on_opening(timeout_s)
            return None
        try:
            grab = self._device.grab(timeout_s)
        except DeviceError as error:
            self._lose(str(error))
            return None
        arrival_ns, now = time.time_ns(), time.monotonic()
        frame = self._take(grab, arrival_ns, now) if grab is not None else None
        if now - self._heard_at > self._silence_s:
            self._lose(f"{self._device.name} sent nothing for {now - self._heard_at:.2f} s")
        elif now - self._good_at > max(USELESS_S, self._silence_s):
            self._lose(f"{self._device.name} sent no good buffer for {now - self._good_at:.2f} s: {self._failure}")
        return frame

    def _take(self, grab: Grab, arrival_ns: int, now: float) -> DepthFrame | None:
        self._heard_at = now
        number = grab.number
        if number is None and self._number is not None:
            number = self._number + 1
        if number is not None:
            if self._number is not None and number > self._number + 1:
                self.counts["lost"] += number - self._number - 1
            self._number = number
        if grab.failure:
            return self._fail(grab.failure, now)
        limits_m = (self._settings.depth_min_m, self._settings.depth_max_m)
        stamp_ns = self._stamp(grab, arrival_ns)
        if stamp_ns <= self._last_stamp_ns:
            return self._fail("its stamp is not later than that of the frame before", now)
        try:
            frame = depth_frame(stamp_ns, grab.components, self._coordinates, limits_m)
        except ImageError as error:
            return self._fail(str(error), now)
        self._last_stamp_ns = stamp_ns
        self._good_at = now
        self._problem = ""
        self.counts["frames"] += 1
        return frame

    def _fail(self, reason: str, now: float) -> None:
        self.counts["failed"] += 1
        self._failed_at, self._failure = now, reason

    def _stamp(self, grab: Grab, arrival_ns: int) -> int:
        """Host time of the frame."""
        if grab.device_ns is None:
            self.told["stamps"] = "arrival: the device gives no time"
            return arrival_ns
        stamp = self._clock.stamp(grab.device_ns, arrival_ns)
        self.told["stamps"] = "device clock"
        self.told["stamp uncertainty [ms]"] = f"{stamp.uncertainty_ns / 1e6:.3f}"
        return stamp.stamp_ns

    def _go_on_opening(self, timeout_s: float) -> None:
        if self._opening is None:
            wait_s = self._retry_at - time.monotonic()
            if wait_s > 0:
                time.sleep(min(wait_s, max(timeout_s, 0.0)))
                return
            self._opening = self._beside.submit(self._open)
        try:
            device = self._opening.result(max(timeout_s, 0.0))
        except NotYet:
            return
        except DeviceError as error:
            self._problem = str(error)
            self._opening = None
            self._retry_at = time.monotonic() + RETRY_S
            return
        self._opening = None
        self._begin(device)

    def _open(self) -> TofDevice:
        """In the thread beside: open the device, set it up, and start it."""
        self._let_go()
        device = self._connect(self._settings)
        try:
            self.warnings = set_up(device.features, self._settings)
            self._coordinates: Coordinates = coordinates(device.features)
            self.camera = intrinsics(device.features)
            rate_hz = self._settings.frame_rate_hz or device.features.get("AcquisitionFrameRate") or SLOWEST_HZ
            self._silence_s = SILENT_FRAMES / max(float(rate_hz), SLOWEST_HZ) + SILENT_S
            device.start()
        except BaseException:
            device.close()
            raise
        return device

    def _begin(self, device: TofDevice) -> None:
        self._device = device
        self._clock = HostClock()
        self._number: int | None = None
        self._heard_at = self._good_at = time.monotonic() + 1.0  # the first frame may take longer
        self._failure = ""
        self.counts["opened"] += 1
        self.told["device"] = device.name
        self._problem = f"{device.name} has sent nothing yet"

    def _lose(self, problem: str) -> None:
        self._problem = f"{problem}; it is being opened again"
        self._lost, self._device = self._device, None

    def _let_go(self) -> None:
        for device in (self._lost, self._device):
            if device is not None:
                device.close()
        self._lost = self._device = None
