"""How a loaded panel bulges out of its plane since the reference, and how far its subsets seem to shift by that."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .compensation.h_pose import pixel_jacobian
from .curvature import tangents
from .geometry import Plane
from .panel_motion import Pose
from .uncertainty import independent_modes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bulge:
    """What N subsets stand out of where they were in the reference, by three curvatures about the panel's plane.

    heights: (N, 3), along the normal by each [m^2], less the plane through them.
    normal: (3,), of the plane in the reference. values: (3,), k_xx, k_xy, k_yy [1/m] in axes of `tangents`, with their
    covariance (3, 3).
    """

    heights: Array
    normal: Array
    values: Array
    covariance: Array

    @classmethod
    def unknown(cls, rays: Array, plane: Plane, bulge_m: float) -> Bulge:
        """As it is expected beforehand.

        Args:
            rays: (N, 3), of the subsets in the reference; NaN for those that it lacks.
            bulge_m: standard deviation of the height at the subset that is farthest from the middle.
        """
        known = np.isfinite(rays).all(axis=1)
        in_plane = plane.points(rays) @ tangents(plane.normal)
        x, y = (in_plane - in_plane[known].mean(axis=0)).T
        heights, flat = np.column_stack([x * x / 2, x * y, y * y / 2]), np.column_stack([np.ones_like(x), x, y])
        heights -= flat @ np.linalg.lstsq(flat[known], heights[known], rcond=None)[0]
        sigma = 2 * bulge_m / np.nanmax(x * x + y * y)
        return cls(heights, plane.normal, np.zeros(3), sigma**2 * np.eye(3))

    @classmethod
    def none(cls, count: int) -> Bulge:
        """Of `count` subsets that stay where they were: there is no curvature."""
        return cls(np.zeros((count, 0)), np.zeros(3), np.zeros(0), np.zeros((0, 0)))

    def part(self, chosen: NDArray[np.intp]) -> Bulge:
        """Of some of the subsets."""
        return replace(self, heights=self.heights[chosen])

    def changed(self, by: Array, covariance: Array | None = None) -> Bulge:
        """With `values` changed, and another covariance if one is given."""
        covariance = self.covariance if covariance is None else covariance
        return replace(self, values=self.values + by, covariance=covariance)

    def shifts(self) -> Array:
        """(N, 3), of the points in the reference frame [m]."""
        return (self.heights @ self.values)[:, None] * self.normal

    def steps(self) -> Array:
        """(3, N, 3), by how much the points move with each curvature [m^2]."""
        return self.heights.T[:, :, None] * self.normal

    def parallax_px(self, camera: Camera, points: Array, pose: Pose) -> Array:
        """(N, 2), by how much the subsets, at points (N, 3) in the reference, are seen elsewhere for it [px]."""
        R, t = pose
        return camera.project((points + self.shifts()) @ R.T + t) - camera.project(points @ R.T + t)

    def doubts_px(self, camera: Camera, points: Array, pose: Pose) -> Array:
        """(3, N, 2), how far they may be seen elsewhere for each independent error of one standard deviation [px]."""
        R, t = pose
        by_each = pixel_jacobian(np.array([camera.fx, camera.fy]), self.steps() @ R.T, points @ R.T + t)
        return np.tensordot(independent_modes(self.covariance), by_each, 1) if len(self.values) else by_each
