"""The panel's plane in the reference frame: of the first ToF frame, and averaged over the latest ones."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from .compensation.h_pose import Pose, fit_pose
from .curvature import Curvature
from .geometry import Plane, pose_from_homography

Array = NDArray[np.float64]
Weighted = tuple[Array, Array]  # three numbers (3,), and the inverse of their covariance (3, 3)
Several = tuple[Array, Array]  # n of them: (n, 3), (n, 3, 3)
WeightedPlane = Weighted  # pi = n / -d
REMEMBERED = 200  # planes that are averaged, the latest ones: ten seconds at 20 Hz
OUTLIER = 4.0  # distance from the median, in units of what the planes scatter, beyond which one is left out
_NONE: Several = np.zeros((0, 3)), np.zeros((0, 3, 3))
CHI2_MEDIAN = 2.366  # median of chi^2 with three degrees of freedom


class ReferencePlane:
    """Carries the plane of every ToF frame back to the reference along the camera's estimated motion.

    The motion back is the pose of the fixed region with the roles swapped: the frame's own plane is the known one, so
    the carried plane does not depend on an earlier estimate. Planes are averaged as pi = n / -d, weighted by their
    inverse covariance, those far from the median left out; if they scatter more than their covariances say, the mean is
    given the larger uncertainty.

    Attributes:
        latest_ns: stamp of the ToF frame whose plane came in last; None before.
        first: the first plane, carried to the reference; None before.
        mean: the average; None before the first.
        first_agrees: whether the first plane is not one of those left out.
        curvature: the average of how the panel is bowed, in axes of `mean`; None as long as no frame told.
    """

    def __init__(self, camera: Camera, robust_sigmas: float):
        self._camera, self._robust_sigmas = camera, robust_sigmas
        self.latest_ns: int | None = None
        self._carried, self._curvatures = _NONE, _NONE
        self.first: Plane | None = None
        self.mean: Plane | None = None
        self.first_agrees = True
        self.curvature: Curvature | None = None

    def knows(self, depth_stamp_ns: int) -> bool:
        """Whether the plane of this ToF frame was the last that came in."""
        return depth_stamp_ns == self.latest_ns

    def add(
        self,
        depth_stamp_ns: int,
        plane: Plane,
        reference_px: Array,
        moved_px: Array,
        sigma_px: Array,
        seed: Array,
        curvature: Curvature | None = None,
        back: Pose | None = None,
    ) -> None:
        """Take in the plane of a ToF frame through an image near it in time.

        Args:
            plane: in the image's frame.
            reference_px, moved_px, sigma_px: (M, 2), the fixed region's found subsets, ideal pixels.
            seed: (3, 3), homography reference -> image.
            curvature: of the panel about the plane, if known.
            back: the motion to the reference, if it is known better than from the plane.

        Raises:
            MeasurementError: if the motion back to the reference cannot be estimated.
        """
        if back is None:
            start = pose_from_homography(self._camera, np.linalg.inv(seed), plane)
            back, *_ = fit_pose(self._camera, moved_px, reference_px, sigma_px, plane, start, self._robust_sigmas)
        R, t = back
        carried = plane.moved(R, t)
        if carried.normal[2] <= 0 or carried.d >= 0:
            raise MeasurementError("a ToF plane, carried to the reference, lies behind the camera")
        self._carried = _with(self._carried, weighted(carried))
        self.latest_ns = depth_stamp_ns
        if self.first is None:
            self.first = carried
        middle = median, scatter = _middle(*self._carried)
        self.mean = Plane.from_inverse_depth(*_mean(*self._carried, *middle))
        pi, weight = weighted(self.first)
        self.first_agrees = bool((pi - median) @ weight @ (pi - median) <= OUTLIER**2 * scatter)
        if curvature is not None:
            self._add_curvature(curvature.turned(plane.normal, R))

    def _add_curvature(self, carried: Curvature) -> None:
        self._curvatures = _with(self._curvatures, (carried.values, np.linalg.inv(carried.covariance)))
        shared = carried.systematic if self.curvature is None else self.curvature.systematic
        self.curvature = Curvature(*_mean(*self._curvatures, *_middle(*self._curvatures)), shared)


def weighted(plane: Plane) -> WeightedPlane:
    """A plane as it is averaged."""
    return plane.inverse_depth, np.linalg.inv(plane.inverse_depth_covariance())


def average_planes(planes: Collection[WeightedPlane]) -> Plane:
    """The mean of planes of one frame without those far from the median.

    If they scatter more than their covariances say, it is given the larger uncertainty.
    """
    values, weights = np.array([value for value, _ in planes]), np.array([weight for _, weight in planes])
    return Plane.from_inverse_depth(*_mean(values, weights, *_middle(values, weights)))


def _with(latest: Several, one: Weighted) -> Several:
    """The latest ones, of which there may be REMEMBERED, and one more."""
    values, weights = (
        np.concatenate([before[1 - REMEMBERED :], now[None]]) for before, now in zip(latest, one, strict=True)
    )
    return values, weights


def _mean(values: Array, weights: Array, median: Array, scatter: float) -> tuple[Array, Array]:
    """The mean (3,) of weighted values, and its covariance (3, 3), as `average_planes` takes it."""
    kept = _squared(values - median, weights) <= OUTLIER**2 * scatter
    covariance = np.linalg.inv(weights[kept].sum(axis=0))
    mean = covariance @ np.einsum("nij,nj->i", weights[kept], values[kept])
    freedom = 3 * (np.sum(kept) - 1)
    if freedom:
        covariance = covariance * max(1.0, float(_squared(values[kept] - mean, weights[kept]).sum()) / freedom)
    return mean, covariance


def _middle(values: Array, weights: Array) -> tuple[Array, float]:
    """The median (3,), and how many times their variance the squared distances from it are, at least 1."""
    median = np.median(values, axis=0)
    return median, max(1.0, float(np.median(_squared(values - median, weights))) / CHI2_MEDIAN)


def _squared(differences: Array, weights: Array) -> Array:
    """Squared length (n,) of each difference (n, 3) under its own weight (n, 3, 3)."""
    return np.einsum("ni,nij,nj->n", differences, weights, differences)
