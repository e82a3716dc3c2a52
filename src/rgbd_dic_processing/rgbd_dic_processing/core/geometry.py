"""Planes, homographies and rigid transforms. Column vectors, X_target = R X_source + t, optical frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plane:
    """n . X + d = 0 in an optical frame [m]: |n| = 1, n_z > 0, so d < 0 and the distance is -d.

    `covariance` (4, 4) is that of (n_x, n_y, n_z, d), rank 3.
    """

    normal: Array
    d: float
    covariance: Array

    @property
    def inverse_depth(self) -> Array:
        """pi = n / -d, (3,) [1/m]: pi . X = 1. Unconstrained, and linear in 1/z: the form in which planes average."""
        return self.normal / -self.d

    def inverse_depth_covariance(self) -> Array:
        """Covariance (3, 3) of `inverse_depth`."""
        jacobian = np.zeros((3, 4))
        jacobian[[0, 1, 2], [0, 1, 2]] = -1 / self.d
        jacobian[:, 3] = self.normal / self.d**2
        return jacobian @ self.covariance @ jacobian.T

    @classmethod
    def from_inverse_depth(cls, pi: Array, covariance: Array | None = None) -> Plane:
        """From pi (3,) [1/m] and its covariance (3, 3)."""
        length = math.hypot(*pi)
        normal = pi / length
        if covariance is None:
            return cls(normal, -1 / length, np.zeros((4, 4)))
        jacobian = np.empty((4, 3))
        jacobian[:3] = (np.eye(3) - normal[:, None] * normal) / length
        jacobian[3] = normal / length**2
        return cls(normal, -1 / length, jacobian @ covariance @ jacobian.T)

    def depths(self, rays: Array) -> Array:
        """z of the points where rays (N, 3) with z = 1 meet the plane (Eq. 2.1) [m]; NaN where they do not."""
        with np.errstate(divide="ignore", invalid="ignore"):
            z = -self.d / (rays @ self.normal)
        return np.where(z > 0, z, np.nan)

    def points(self, rays: Array) -> Array:
        """The points (N, 3) [m] where rays (N, 3) meet the plane (Eq. 2.2)."""
        return rays * self.depths(rays)[..., None]

    def moved(self, R: Array, t: Array) -> Plane:
        """The same plane in the frame reached by X' = R X + t."""
        normal = R @ self.normal
        blocks = np.zeros((4, 4))
        blocks[:3, :3], blocks[3, :3], blocks[3, 3] = R, -t @ R, 1
        return Plane(normal, float(self.d - normal @ t), blocks @ self.covariance @ blocks.T)


def plane_homography(camera: Camera, R: Array, t: Array, plane: Plane) -> Array:
    """H = K (R - t n^T / d) K^-1, (3, 3): ideal pixels of the source frame -> of the target (Eq. 2.3, column form)."""
    return plane_homographies(camera, R, t, plane.inverse_depth)


def plane_homographies(camera: Camera, R: Array, t: Array, pi: Array) -> Array:
    """As `plane_homography`, of a plane by its `inverse_depth` (3,); or of several: R (k, 3, 3), t (k, 3) or pi (k, 3)
    give (k, 3, 3)."""
    return camera.matrix @ (R + t[..., :, None] * pi[..., None, :]) @ camera.inverse_matrix


def pose_from_homography(camera: Camera, H: Array, plane: Plane) -> tuple[Array, Array]:
    """R (3, 3), t (3,) [m] of the plane-induced homography H of a known plane: the inverse of `plane_homography`.

    K^-1 H K = s (R - t n^T / d). Two vectors across n lose the second term, which gives s and R; the rest is t.
    R is the rotation nearest to the (noisy) result.
    """
    M = camera.inverse_matrix @ H @ camera.matrix
    source = _axes(plane.normal)
    moved = M @ source[:, :2]
    s = np.prod(np.sum(moved**2, axis=0)) ** 0.25
    if np.linalg.det(M) < 0:
        s = -s
    first, second = (moved / s).T.tolist()
    R = nearest_rotation(np.array([first, second, _cross(first, second)]).T @ source.T)
    t = plane.d * (R - M / s) @ plane.normal
    return R, t


def _axes(normal: Array) -> Array:
    """Two unit vectors across a unit vector and each other, and what is across both, (3, 3)."""
    n = normal.tolist()
    least = min(range(3), key=lambda axis: abs(n[axis]))
    first = _cross(n, [float(axis == least) for axis in range(3)])
    length = math.hypot(*first)
    first = [value / length for value in first]
    second = _cross(n, first)
    return np.array([first, second, _cross(first, second)]).T


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """np.cross of two vectors, without its cost."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def apply_homography(H: Array, points_px: Array) -> Array:
    """Points (N, 2) -> (N, 2), or (k, N, 2) by several homographies (k, 3, 3); NaN for a point that goes to infinity or
    behind."""
    points = np.asarray(points_px, float)
    homogeneous = H[..., :2] @ np.swapaxes(points, -1, -2) + H[..., 2:]  # (..., 3, N): NumPy is slow on rows of three
    w = homogeneous[..., 2:, :]
    return np.swapaxes(homogeneous[..., :2, :] / np.where(w > 0, w, np.nan), -1, -2)


def homography_jacobian(H: Array, points_px: Array) -> Array:
    """(N, 2, 2), how much the images of points (N, 2) move with them."""
    w = points_px @ H[2, :2] + H[2, 2]
    u, v = apply_homography(H, points_px).T
    entries = [(H[0, i] - u * H[2, i]) / w for i in (0, 1)], [(H[1, i] - v * H[2, i]) / w for i in (0, 1)]
    return np.moveaxis(np.array(entries), -1, 0)


def nearest_rotation(M: Array) -> Array:
    """The rotation (3, 3) nearest to M in the Frobenius norm."""
    u, _, vt = np.linalg.svd(M)
    if np.linalg.det(u @ vt) < 0:
        u[:, 2] = -u[:, 2]
    return u @ vt


def rigid_transform(source: Array, target: Array) -> tuple[Array, Array]:
    """R, t that minimise sum |target - R source - t|^2 over points (N, 3), N >= 3 (Kabsch 1976)."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    R = nearest_rotation((target - target_mean).T @ (source - source_mean))
    return R, target_mean - R @ source_mean


def skew(vectors: Array) -> Array:
    """(N, 3) -> (N, 3, 3) with skew(a) @ b = a x b."""
    a = np.asarray(vectors, float)
    zero = np.zeros(a.shape[:-1])
    rows = [
        np.stack([zero, -a[..., 2], a[..., 1]], axis=-1),
        np.stack([a[..., 2], zero, -a[..., 0]], axis=-1),
        np.stack([-a[..., 1], a[..., 0], zero], axis=-1),
    ]
    return np.stack(rows, axis=-2)
