"""What a graph says of an image -> the messages that viewers show of it; of a running graph, or of a bag."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Calibration, pixel_rays
from rgbd_dic_acquisition.errors import CalibrationError, ImageError
from rgbd_dic_acquisition.messages import MessageFactory

from ..core.crack import CrackOpening
from ..core.displacement_field import DisplacementField
from ..core.plane import PlaneEstimate
from ..core.regions import Regions
from ..core.subset_field import Reference
from ..core.view import ColourScale, Viewing, nearest_plane
from .view_messages import ViewerSettings, cloud_message, view_messages

PLANES_KEPT, REFERENCES_KEPT = 64, 8


class Viewer:
    """Remembers what images rest on: references with their regions, and planes."""

    def __init__(self, make: MessageFactory, calibration: Calibration, settings: ViewerSettings):
        self._make, self._calibration, self._settings = make, calibration, settings
        self._viewing, self._scale = Viewing(calibration.camera), ColourScale()
        self._rays = pixel_rays(calibration.tof) if calibration.tof is not None else None
        self._regions: dict[int, Regions | None] = {}
        self._planes: deque[PlaneEstimate] = deque(maxlen=PLANES_KEPT)

    def know_reference(self, reference: Reference) -> None:
        kept = list(self._regions.items())[1 - REFERENCES_KEPT :]
        self._regions = {**dict(kept), reference.stamp_ns: reference.regions}

    def know_plane(self, estimate: PlaneEstimate) -> None:
        self._planes.append(estimate)

    def messages(
        self,
        frame_id: str,
        small: NDArray[np.uint8],
        homography: NDArray[np.float64],
        field: DisplacementField,
        opening: CrackOpening,
    ) -> dict[str, Callable[[], Any]]:
        """As `view_messages`, for an image, made small, with its field and its opening; see `Viewing.view`."""
        plane = nearest_plane(self._planes, field.stamp_ns)
        view = self._viewing.view(small, homography, self._regions.get(field.reference_stamp_ns), field, plane)
        self._scale.widen(field.reference_stamp_ns, view.displacement_m[:, 0])
        return view_messages(self._make, field.stamp_ns, frame_id, view, self._scale, opening, self._settings)

    def cloud_of_depth(self, stamp_ns: int, frame_id: str, depth_m: NDArray[np.float32]) -> Any:
        """The message of a depth image (rows, cols) [m]: of every so-manieth row and column.

        Raises:
            ImageError: if it is not of the calibrated size.
            CalibrationError: if the ToF sensor's intrinsics are not known.
        """
        if self._rays is None:
            raise CalibrationError("calibration.yaml has no entry 'tof', which depth images need")
        if depth_m.shape != self._rays.shape[:2]:
            raise ImageError(
                f"depth image of {depth_m.shape[1]} x {depth_m.shape[0]} px: calibrated are "
                f"{self._rays.shape[1]} x {self._rays.shape[0]} px"
            )
        every = math.ceil(math.sqrt(depth_m.size / self._settings.most_points))
        depth, rays = depth_m[::every, ::every], self._rays[::every, ::every]
        valid = np.isfinite(depth)
        return self.cloud(stamp_ns, frame_id, rays[valid] * depth[valid, None].astype(float))

    def cloud(self, stamp_ns: int, frame_id: str, points_m: NDArray[np.float64]) -> Any:
        """The message of points (N, 3) in the frame of the ToF sensor [m], every so-manieth if there are too many."""
        points = points_m[:: max(1, math.ceil(len(points_m) / self._settings.most_points))]
        points = points @ self._calibration.R_camera_tof.T + self._calibration.t_camera_tof
        return cloud_message(self._make, stamp_ns, frame_id, points, nearest_plane(self._planes, stamp_ns))
