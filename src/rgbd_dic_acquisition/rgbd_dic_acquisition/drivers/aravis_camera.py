"""A greyscale camera through Aravis: GenICam over USB3 Vision or GigE Vision."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np

from ..calibration import Camera
from ..clock import NS, HostClock
from ..errors import DeviceError
from ..sources import ImageFrame
from .aravis_connection import AravisSettings, Connection
from .aravis_library import aravis

NUMBERS = 65536


class AravisCamera:
    """One camera. Opened again after `close`, it counts on and begins with a new comparison of the clocks.

    Attributes:
        counts: images by what became of them: "received", "incomplete" (packets were missing), "lost" (numbers that
            never came, by the camera's own count).
        told: what is known of the camera, in words: model, serial number, temperature, clock.
        period_s: time between images; infinite with a trigger.
        uncertainty_ns: standard uncertainty of the latest stamp [ns]; infinite until known.
    """

    def __init__(self, settings: AravisSettings, camera: Camera, frame_id: str) -> None:
        aravis()
        self.camera, self.frame_id = camera, frame_id
        self.counts: Counter[str] = Counter({"received": 0, "incomplete": 0, "lost": 0})
        self.told: dict[str, str] = {}
        self.period_s = math.inf if settings.trigger_source else 1 / settings.frame_rate_hz
        self.uncertainty_ns = math.inf
        self._settings = settings
        self._connection: Connection | None = None

    def open(self) -> None:
        """Connect, set everything, start.

        Raises:
            DeviceError: the camera is not found, does not answer, or is another program's.
            SettingsError: it refuses a setting, or takes another value.
        """
        self.close()
        self._connection = Connection(self._settings, self.camera)
        self._clock = HostClock(fixed_delay_ns=round(self._settings.delivery_s * NS))
        self._last_number: int | None = None
        self.told.update(self._connection.told)

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()

    def __enter__(self) -> AravisCamera:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(self, timeout_s: float) -> ImageFrame | None:
        """The next whole image, or None if none came in time.

        Raises:
            DeviceError: the connection is lost.
        """
        connection = self._connection
        if connection is None or connection.lost:
            raise DeviceError(f"the camera is gone: control of {self.told.get('camera', 'it')} was lost")
        buffer = connection.stream.timeout_pop_buffer(max(round(timeout_s * 1e6), 0))
        if buffer is None:
            return None
        try:
            return self._frame(connection, buffer)
        finally:
            connection.stream.push_buffer(buffer)

    def _frame(self, connection: Connection, buffer: Any) -> ImageFrame | None:
        self._count_lost(buffer.get_frame_id())
        rows, cols = self.camera.height, self.camera.width
        whole = buffer.get_status() == aravis().BufferStatus.SUCCESS
        if not whole or (buffer.get_image_width(), buffer.get_image_height()) != (cols, rows):
            self.counts["incomplete"] += 1
            return None
        self.counts["received"] += 1
        while connection.latches:
            self._clock.latch(*connection.latches.popleft())
        half_ns = connection.exposure_ns // 2
        device_ns = buffer.get_timestamp() + (half_ns if self._settings.stamps == "start" else -half_ns)
        host = self._clock.stamp(device_ns, buffer.get_system_timestamp())
        self.uncertainty_ns = host.uncertainty_ns
        source = "latches" if self._clock.latched else "arrivals"
        self.told["clock"] = f"by {source}, to {host.uncertainty_ns * 1e-6:.3f} ms"
        self.told.update(connection.readings)
        pixels = np.frombuffer(buffer.get_data(), np.uint8, rows * cols).reshape(rows, cols)
        return ImageFrame(host.stamp_ns, pixels, device_ns)

    def _count_lost(self, number: int) -> None:
        """From the numbers of the frames, whose lowest 16 bits count. One that was given up may come after others."""
        if self._last_number is None:
            self._last_number = number
        step = (number - self._last_number + NUMBERS // 2) % NUMBERS - NUMBERS // 2
        if step > 0:
            skipped = self._settings.transport == "gige" and number < self._last_number  # zero is not used there
            self.counts["lost"] += step - 1 - skipped
            self._last_number = number
        elif step < 0:
            self.counts["lost"] -= 1
