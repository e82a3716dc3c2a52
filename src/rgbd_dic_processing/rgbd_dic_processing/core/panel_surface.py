"""The panel in the reference: a plane, slightly curved, and how its points and pixels move with its shape."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .bulge import Bulge
from .compensation.h_pose import Pose, fit_pose, pixel_jacobian, pose_jacobian
from .geometry import Plane, pose_from_homography
from .uncertainty import independent_modes, least_squares

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """The panel in the reference frame: 1/z = terms . inverse_depth for the ray of each subset.

    terms: (N, 6); the first three are the ray (g_x, g_y, 1), so that alone they are a plane; the others curve it.
    inverse_depth: (6,) [1/m], with its covariance (6, 6).
    """

    camera: Camera
    rays: Array
    terms: Array
    inverse_depth: Array
    covariance: Array

    @classmethod
    def flat(cls, camera: Camera, reference_px: Array, plane: Plane) -> Surface:
        """A plane; `terms` are (N, 3) and `inverse_depth` is (3,)."""
        rays = camera.rays(reference_px)
        return cls(camera, rays, rays, plane.inverse_depth, plane.inverse_depth_covariance())

    def part(self, chosen: NDArray[np.intp]) -> Surface:
        """As some of the subsets see it."""
        return replace(self, rays=self.rays[chosen], terms=self.terms[chosen])

    def changed(self, by: Array, covariance: Array | None = None) -> Surface:
        """With `inverse_depth` changed, and another covariance if one is given."""
        covariance = self.covariance if covariance is None else covariance
        return replace(self, inverse_depth=self.inverse_depth + by, covariance=covariance)

    @cached_property
    def plane(self) -> Plane:
        """That is nearest to it over the whole panel."""
        return Plane.from_inverse_depth(self.inverse_depth[:3], self.covariance[:3, :3])

    def points(self) -> Array:
        """(N, 3) of the subsets [m]."""
        return self.rays / (self.terms @ self.inverse_depth)[:, None]

    def steps(self) -> Array:
        """(6, N, 3), by how much the points move with `inverse_depth` [m^2]."""
        return -self.points() * (self.terms / (self.terms @ self.inverse_depth)[:, None]).T[:, :, None]

    def parallax_px(self, pose: Pose) -> Array:
        """(N, 2), by how much the subsets are seen elsewhere than if they lay on the plane [px]."""
        R, t = pose
        turned = (R @ self.rays.T).T  # each coordinate together in memory, as in `columns`
        depths = 1 / (self.terms @ self.inverse_depth), self.plane.depths(self.rays)
        here, on_plane = (self.camera.project(turned * z[:, None] + t) for z in depths)
        return here - on_plane

    def fit_pose(
        self, moved_px: Array, sigma_px: Array, fixed: NDArray[np.intp], seed: Array, robust_sigmas: float
    ) -> tuple[Pose, Array, Array, float]:
        """As `fit_pose`, of the subsets `fixed` (M,) of (N, 2), with the parallax in the pose of the seed (3, 3).

        Raises:
            MeasurementError: if it does not converge.
        """
        plane = self.plane
        start = pose_from_homography(self.camera, seed, plane)
        flat = (moved_px - self.parallax_px(start))[fixed]
        pixels = self.camera.project(self.rays[fixed])
        return fit_pose(self.camera, pixels, flat, sigma_px[fixed], plane, start, robust_sigmas)

    def doubts_px(self, pose: Pose, fixed: NDArray[np.intp], bulge: Bulge | None = None) -> Array:
        """(k, N, 2), how far the subsets may be seen elsewhere, for each independent error of the curvature, and of the
        bulge, of one standard deviation: beyond what goes with the plane, and what the pose, fitted to the fixed
        region, takes up [px]."""
        plane, across = self.covariance[:3, :3], self.covariance[:3, 3:]
        of_curvature = self.covariance[3:, 3:] - across.T @ np.linalg.solve(plane, across)
        by_pose, by_depth = self._by_pose_and_depth(pose)
        by_pose, by_depth = np.swapaxes(by_pose, 1, 2), by_depth.T  # each coordinate together, as it is in memory
        shifts = (independent_modes(of_curvature) @ self.terms[:, 3:].T)[:, None] * by_depth
        if bulge is not None:
            of_bulge = bulge.doubts_px(self.camera, self.points(), pose)
            shifts = np.concatenate([shifts, np.swapaxes(of_bulge, 1, 2)])
        of_fixed = by_pose[..., fixed].reshape(6, -1).T, shifts[..., fixed].reshape(len(shifts), -1).T
        taken_up = least_squares(*of_fixed).T @ by_pose.reshape(6, -1)
        return np.swapaxes(shifts - taken_up.reshape(shifts.shape), 1, 2)

    def by_shape(self, pose: Pose) -> tuple[Array, Array]:
        """(6, N, 2), by how many pixels the subsets move with the pose (rotation vector, translation), and with
        `inverse_depth`."""
        by_pose, by_depth = self._by_pose_and_depth(pose)
        return by_pose, np.swapaxes(self.terms.T[:, None] * by_depth.T, 1, 2)

    def _by_pose_and_depth(self, pose: Pose) -> tuple[Array, Array]:
        """(6, N, 2) and (N, 2), by how many pixels the subsets move with the pose, and with their 1/z."""
        R, t = pose
        depths = 1 / (self.terms @ self.inverse_depth)
        turned = (R @ self.rays.T).T * depths[:, None]
        focal, steps = np.array([self.camera.fx, self.camera.fy]), turned * -depths[:, None]
        return pose_jacobian(focal, turned, turned + t), pixel_jacobian(focal, steps, turned + t)
