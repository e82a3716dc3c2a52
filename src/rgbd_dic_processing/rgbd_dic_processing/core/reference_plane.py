"""The panel's plane in the reference frame: of the first ToF frame, and averaged over all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from .compensation.h_pose import fit_pose
from .geometry import Plane, pose_from_homography

Array = NDArray[np.float64]


class ReferencePlane:
    """Carries the plane of every ToF frame back to the reference along the camera's estimated motion.

    The motion back is the pose of the fixed region with the roles swapped: the frame's own plane is the known one, so
    the carried plane does not depend on an earlier estimate. Planes are averaged as pi = n / -d, weighted by their
    inverse covariance; if they scatter more than that says, the mean is given the larger uncertainty.
    """

    def __init__(self, camera: Camera, robust_sigmas: float):
        self._camera, self._robust_sigmas = camera, robust_sigmas
        self._newest_ns, self._count = -1, 0
        # sums of W, W pi and pi . W pi over the carried planes
        self._weight, self._weighted, self._squared = np.zeros((3, 3)), np.zeros(3), 0.0
        self.first: Plane | None = None
        self.mean: Plane | None = None

    def knows(self, depth_stamp_ns: int) -> bool:
        """Whether the plane of this ToF frame, or of a later one, is in already."""
        return depth_stamp_ns <= self._newest_ns

    def add(
        self,
        depth_stamp_ns: int,
        plane: Plane,
        reference_px: Array,
        moved_px: Array,
        sigma_px: Array,
        seed: Array,
    ) -> None:
        """Take in the plane of a ToF frame through an image near it in time.

        Args:
            plane: in the image's frame.
            reference_px, moved_px, sigma_px: (M, 2), the fixed region's found subsets, ideal pixels.
            seed: (3, 3), homography reference -> image.

        Raises:
            MeasurementError: if the motion back to the reference cannot be estimated.
        """
        start = pose_from_homography(self._camera, np.linalg.inv(seed), plane)
        (R, t), *_ = fit_pose(self._camera, moved_px, reference_px, sigma_px, plane, start, self._robust_sigmas)
        carried = plane.moved(R, t)
        if carried.normal[2] <= 0 or carried.d >= 0:
            raise MeasurementError("a ToF plane, carried to the reference, lies behind the camera")
        pi, weight = carried.inverse_depth, np.linalg.inv(carried.inverse_depth_covariance())
        self._weight = self._weight + weight
        self._weighted = self._weighted + weight @ pi
        self._squared += float(pi @ weight @ pi)
        self._newest_ns, self._count = depth_stamp_ns, self._count + 1
        if self.first is None:
            self.first = carried
        self.mean = self._average()

    def _average(self) -> Plane:
        covariance = np.linalg.inv(self._weight)
        mean = covariance @ self._weighted
        freedom = 3 * (self._count - 1)
        if freedom:
            chi2 = self._squared - mean @ self._weighted
            covariance = covariance * max(1.0, chi2 / freedom)
        return Plane.from_inverse_depth(mean, covariance)
