"""The panel's plane at the moment of an image, from the ToF frames of other moments."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from .geometry import Plane
from .panel_motion import PanelMotion, Pose, pose_sensitivity
from .reference_plane import REMEMBERED, WeightedPlane, average_planes, weighted

Array = NDArray[np.float64]
LATEST = 8  # images that the pose at the moment of a ToF frame is interpolated from


class CarriedPlanes:
    """Carries each ToF plane from its own moment to the reference, and the mean of the latest ones to an image.

    Both ways go along the motion of the fixed region, which is interpolated between two images. Only ToF frames up to
    the image are used, so that no image waits for the next one.

    Attributes:
        reference: the mean of all remembered planes, in the reference frame; None before the first.
    """

    def __init__(self, window_s: float):
        self._window_ns = round(window_s * 1e9)
        self._newest_ns = -1
        self._waiting: dict[int, Plane] = {}
        self._carried: deque[tuple[int, WeightedPlane]] = deque(maxlen=REMEMBERED)
        self.reference: Plane | None = None

    def add(self, depth_stamp_ns: int, plane: Plane) -> None:
        """The plane of the next ToF frame at its own moment; the same one again changes nothing.

        One that is earlier begins anew, as the clocks jumped back.
        """
        if depth_stamp_ns < self._newest_ns:
            self._waiting.clear()
            self._carried.clear()
        if depth_stamp_ns != self._newest_ns:
            self._newest_ns = depth_stamp_ns
            self._waiting[depth_stamp_ns] = plane

    def at_image(self, stamp_ns: int, motion: PanelMotion, pose: Pose, pose_covariance: Array) -> Plane | None:
        """The plane in an image; None if no ToF frame of the window could be carried.

        Its covariance is that of its difference from `reference`, carried to the image: the error that the two share
        moves both.

        Args:
            motion: up to this image.
            pose, pose_covariance: of this image, (6, 6) for a rotation vector and a shift.
        """
        for depth_stamp_ns in [stamp for stamp in self._waiting if stamp <= stamp_ns]:
            plane = self._waiting.pop(depth_stamp_ns)
            R, t = (values[0] for values in motion.at(np.array([depth_stamp_ns]), LATEST))
            if np.isfinite(t).all():
                back = R.T, -R.T @ t
                noise = _of_pose(plane.moved(*back), (R, t), pose_covariance)
                plane = Plane.from_inverse_depth(plane.inverse_depth, plane.inverse_depth_covariance() + noise)
                self._carried.append((depth_stamp_ns, weighted(plane.moved(*back))))
        latest = [plane for stamp, plane in self._carried if stamp >= stamp_ns - self._window_ns]
        if not latest:
            return None
        every = average_planes([plane for _, plane in self._carried])
        mean = average_planes(latest)
        self.reference = every
        apart = mean.inverse_depth_covariance() - every.inverse_depth_covariance()
        seen = Plane.from_inverse_depth(mean.inverse_depth, apart).moved(*pose)
        covariance = seen.inverse_depth_covariance() + _of_pose(mean, pose, pose_covariance)
        return Plane.from_inverse_depth(seen.inverse_depth, covariance)


def _of_pose(plane: Plane, pose: Pose, covariance: Array) -> Array:
    """(3, 3): what the uncertainty of a pose adds to that of a reference plane carried by it [1/m^2]."""
    by_pose = pose_sensitivity(plane.inverse_depth, pose)
    return by_pose @ covariance @ by_pose.T
