"""The panel frame: as if the camera faced the panel squarely (thesis 2.4).

x along the panel's x axis, y 90 degrees from it (downwards), z into the wall; origin at the camera's centre, so that
the panel is the plane z = -d.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RegionsError

from .geometry import Plane, apply_homography

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Realignment:
    """R_0 (3, 3) turns the reference camera frame into the panel frame; its rows are the panel's axes."""

    camera: Camera
    plane: Plane
    R_panel_camera: Array

    def from_pixels(self, points_px: Array) -> Array:
        """Ideal pixels (N, 2) of the reference -> panel coordinates (N, 2) [m]."""
        return apply_homography(self.homography, points_px)

    @cached_property
    def homography(self) -> Array:
        """(3, 3), ideal pixels of the reference -> panel coordinates [m]: H_0 = K R_0 K^-1 (Eq. 2.6), then from the
        principal point the scale -d/f (Eq. 2.7), which together leave no K on the left."""
        return np.diag([-self.plane.d, -self.plane.d, 1.0]) @ self.R_panel_camera @ self.camera.inverse_matrix

    def from_points(self, points_m: Array) -> Array:
        """Points (N, 3) in the reference camera frame [m] -> panel frame (N, 3) [m]."""
        return points_m @ self.R_panel_camera.T


def realign_to_axis(camera: Camera, plane: Plane, axis_px: Array) -> Realignment:
    """From two points (2, 2) of the panel's x axis in ideal pixels of the reference; y follows at 90 degrees."""
    start, end = plane.points(camera.rays(axis_px))
    x = end - start
    if not np.all(np.isfinite(x)) or np.linalg.norm(x) < 1e-6:
        raise RegionsError(f"x_axis: the points {np.asarray(axis_px).tolist()} do not lie on the panel's plane")
    return _realignment(camera, plane, x)


def realign_to_principal_axes(camera: Camera, plane: Plane, points_px: Array) -> Realignment:
    """From the principal components of the panel's points (N, 2) [ideal px], put on the plane.

    The smallest component is z. Of the others the larger is x if the points spread wider than high in the image,
    else y; signs such that the diagonal of R_0 is positive (thesis 2.4).
    """
    points = plane.points(camera.rays(points_px))
    spread = points[np.isfinite(points).all(axis=1)]
    _, vectors = np.linalg.eigh(np.cov(spread.T))
    width, height = np.ptp(points_px, axis=0)
    long = vectors[:, 2]
    if width >= height:
        return _realignment(camera, plane, long if long[0] >= 0 else -long)
    y = long if long[1] >= 0 else -long
    return _realignment(camera, plane, np.cross(y, plane.normal))


def _realignment(camera: Camera, plane: Plane, x: Array) -> Realignment:
    z = plane.normal
    x = x - z * (x @ z)
    x = x / np.linalg.norm(x)
    return Realignment(camera, plane, np.vstack([x, np.cross(z, x), z]))
