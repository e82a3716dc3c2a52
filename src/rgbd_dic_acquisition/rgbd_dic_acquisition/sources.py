"""What every camera and every ToF sensor offers to the nodes, be it real or simulated."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .calibration import Camera


@dataclass(frozen=True)
class ImageFrame:
    """One image of the greyscale camera.

    Attributes:
        stamp_ns: host time of the middle of the exposure [ns since the epoch].
        image: (rows, cols) uint8.
        device_ns: the same moment by the camera's own clock [ns]; None if it has none.
    """

    stamp_ns: int
    image: NDArray[np.uint8]
    device_ns: int | None = None


@dataclass(frozen=True)
class DepthFrame:
    """One frame of the ToF sensor; all arrays (rows, cols).

    Attributes:
        stamp_ns: host time of the middle of the exposure [ns since the epoch].
        depth_m: float32, along z [m]; NaN where there is none.
        intensity: uint16, without unit; None if the sensor gives none.
        confidence: uint16, without unit, 0 where there is no depth; None if the sensor gives none.
        points_m: (rows, cols, 3) float32 in the optical frame [m], NaN where there is none; None if the sensor
            gives depth alone.
        device_ns: the moment of the stamp by the sensor's own clock [ns]; None if it has none.
    """

    stamp_ns: int
    depth_m: NDArray[np.float32]
    intensity: NDArray[np.uint16] | None = None
    confidence: NDArray[np.uint16] | None = None
    points_m: NDArray[np.float32] | None = None
    device_ns: int | None = None


class _Source(Protocol):
    camera: Camera
    frame_id: str

    def open(self) -> None:
        """Connect and start.

        Raises:
            RgbdDicError: the sensor is not there or refuses; with what to do.
        """

    def close(self) -> None:
        """Stop and disconnect; may be called at any time, and more than once."""

    def __enter__(self) -> _Source: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...


class CameraSource(_Source, Protocol):
    """A greyscale camera. `camera` holds its calibration, `frame_id` its optical frame."""

    def read(self, timeout_s: float) -> ImageFrame | None:
        """The next image, or None if none came in time (0 or less does not wait).

        Raises:
            DeviceError: the camera is lost; `close` and `open` may bring it back.
        """


class TofSource(_Source, Protocol):
    """A ToF sensor. `camera` holds its calibration, `frame_id` its optical frame."""

    def read(self, timeout_s: float) -> DepthFrame | None:
        """The next frame, or None if none came in time (0 or less does not wait)."""
