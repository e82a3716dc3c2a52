"""Exact scenes without images: where the subsets of a cracked plane would be found, from the geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.pairing import FramePair
from rgbd_dic_processing.core.plane import PlaneEstimate
from rgbd_dic_processing.core.regions import CrackZones, Regions
from rgbd_dic_processing.core.search import SeedSource
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import Reference, SubsetField
from scipy.spatial.transform import Rotation

SUBSET, STEP = 31, 10


@dataclass(frozen=True)
class ExactScene:
    """A panel seen in the reference under `R_camera_panel`, `t_camera_panel`; the part right of x = 0 moves."""

    camera: Camera
    R: np.ndarray
    t: np.ndarray
    crack_x_m: float = 0.0

    @property
    def regions(self) -> Regions:
        w, h = self.camera.width, self.camera.height
        crack = self.to_pixels(np.array([[self.crack_x_m, -1e-3, 0], [self.crack_x_m, 1e-3, 0]]), self.R, self.t)
        middle, direction = crack.mean(axis=0), crack[1] - crack[0]
        zones = CrackZones.from_point(middle, direction, across=80, along=160, gap=20)
        panel = np.array([(5, 5), (w - 6, 5), (w - 6, h - 6), (5, h - 6)], float)
        # beside the crack, on the side that stays: panel x from -0.22 to -0.03 m
        fixed = self.to_pixels(
            np.array([(-0.22, -0.15, 0), (-0.03, -0.15, 0), (-0.03, 0.15, 0), (-0.22, 0.15, 0)]),
            self.R,
            self.t,
        )
        x_axis = self.to_pixels(np.array([[-0.1, 0, 0], [0.1, 0, 0]]), self.R, self.t)
        return Regions(panel, (fixed,), x_axis, zones)

    @property
    def reference(self) -> Reference:
        centres = self.regions.subset_centres(self.camera.width, self.camera.height, SUBSET, STEP)
        return Reference.first(1, np.zeros((self.camera.height, self.camera.width), np.uint8), centres, SUBSET, STEP)

    def plane(self, R: np.ndarray, t: np.ndarray, sigma: float = 1e-6) -> Plane:
        """The panel's plane z = 0 in a camera at X_camera = R X_panel + t, with a small covariance."""
        normal = R[:, 2]
        plane = Plane(normal, float(-normal @ t), np.zeros((4, 4)))
        return Plane.from_inverse_depth(plane.inverse_depth, sigma**2 * np.eye(3))

    def to_pixels(self, points_m: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        return self.camera.distort(self.camera.project(points_m @ R.T + t))

    def material(self) -> np.ndarray:
        """Panel coordinates (N, 3) of the subset centres in the reference."""
        rays = self.camera.rays(self.camera.undistort(self.reference.centres_px.astype(float)))
        return (self.plane(self.R, self.t).points(rays) - self.t) @ self.R

    def field(self, stamp: int, R: np.ndarray, t: np.ndarray, jump_m: np.ndarray) -> SubsetField:
        """The subset field of a frame with the camera at R, t and the right part displaced by jump_m (3,)."""
        points = self.material()
        points[points[:, 0] > self.crack_x_m] += jump_m
        moved = self.to_pixels(points, R, t)
        R_step = R @ self.R.T
        t_step = t - R_step @ self.t
        plane = self.plane(self.R, self.t)
        K = self.camera.matrix
        seed = K @ (R_step - np.outer(t_step, plane.normal) / plane.d) @ np.linalg.inv(K)
        count = len(moved)
        return SubsetField(
            stamp,
            1,
            1,
            FrameStatus.OK,
            "",
            SeedSource.PREDICTION,
            SUBSET,
            seed / seed[2, 2],
            moved,
            np.full((count, 2), 0.005, np.float32),
            np.ones(count, np.float32),
            np.ones(count, np.uint8),
            np.zeros(count, np.uint8),
        )

    def estimate(self, stamp: int, R: np.ndarray, t: np.ndarray) -> PlaneEstimate:
        return PlaneEstimate(stamp, FrameStatus.OK, "", self.plane(R, t), 1000, 1000, 0.001)


def pose(rotation_deg: tuple[float, float, float], t: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """X_camera = R X_panel + t from xyz angles in degrees."""
    return Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix(), np.array(t)


def pair(stamp: int) -> FramePair:
    return FramePair(stamp, stamp)
