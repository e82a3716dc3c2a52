"""The shape of the panel in the reference: a plane, and how it is slightly curved, from how views differ (parallax).

A camera that turns around a panel sees what stands out of its plane shift: by 0.2 mm for 0.8 mm under 15 degrees. What
the ToF sensor knows of the shape is ten times coarser, so the images tell, as far as the camera did turn; before, the
panel is taken for what the ToF sensor's plane says, and its curvature if that is asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .compensation.h_pose import Pose, fit_pose, pixel_jacobian, pose_jacobian
from .curvature import Curvature, tangents
from .geometry import Plane, homography_jacobian, pose_from_homography
from .reference_noise import REFERENCE_PART, SharedReference
from .uncertainty import independent_modes

Array = NDArray[np.float64]

TOF_ERROR_M = 0.004  # by which the ToF sensor's plane may be wrong at the panel's edges, whatever its noise
DEFORMS_ALIKE_S = 0.25  # a structure under a load that changes in a second or more
INDEPENDENT = 10  # parts of the region that a misfit counts for: what deforms, deforms together


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

    @property
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
        on_plane = self.plane.points(self.rays)
        return self.camera.project(self.points() @ R.T + t) - self.camera.project(on_plane @ R.T + t)

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

    def doubts_px(self, pose: Pose, fixed: NDArray[np.intp]) -> Array:
        """(3, N, 2), how far the subsets may be seen elsewhere, for each independent error of the curvature of one
        standard deviation: beyond what goes with the plane, and what the pose, fitted to the fixed region, takes up
        [px]."""
        plane, across = self.covariance[:3, :3], self.covariance[:3, 3:]
        of_curvature = self.covariance[3:, 3:] - across.T @ np.linalg.solve(plane, across)
        by_pose, by_shape = self.by_shape(pose)
        shifts = np.tensordot(independent_modes(of_curvature), by_shape[3:], 1)
        taken_up = np.linalg.pinv(by_pose[:, fixed].reshape(6, -1).T) @ shifts[:, fixed].reshape(len(shifts), -1).T
        return shifts - np.tensordot(taken_up.T, by_pose, 1)

    def by_shape(self, pose: Pose) -> tuple[Array, Array]:
        """(6, N, 2), by how many pixels the subsets move with the pose (rotation vector, translation), and with
        `inverse_depth`."""
        R, t = pose
        turned = self.points() @ R.T
        focal = np.array([self.camera.fx, self.camera.fy])
        return pose_jacobian(focal, turned, turned + t), pixel_jacobian(focal, self.steps() @ R.T, turned + t)


@dataclass(frozen=True)
class ShapeEvidence:
    """What one view tells of the shape beside motion and deformation, and the surface as it is known with this view.

    subsets: (M,), that it rests on, with the uncertainty of their places, sigma_px (M, 2), times the root of how many
    see the same noise. seed: (3, 3), homography reference -> image, ideal pixels. residual_px, weights: (M, 2), of the
    pixels that the shape, as far as it is not `before` (6,), and the r other unknowns explain. by_shape, by_others:
    (6, M, 2) and (r, M, 2), how the pixels move with them. stiffness: (r, r), information about the others.
    """

    surface: Surface
    before: Array
    subsets: NDArray[np.intp]
    sigma_px: Array
    seed: Array
    residual_px: Array
    weights: Array
    by_shape: Array
    by_others: Array
    stiffness: Array


class SurfaceEstimate:
    """Least squares of all views so far: each frame's pose is eliminated, what is left tells of the shape.

    Args:
        reference_px: (N, 2) ideal pixels of the subsets in the reference; NaN for those that it lacks.
        bow_m: standard deviation that the panel is believed to stand out of its plane by.
    """

    def __init__(self, camera: Camera, reference_px: Array, bow_m: float, robust_sigmas: float):
        self._camera, self._reference_px, self._robust_sigmas = camera, reference_px, robust_sigmas
        self._rays = camera.rays(reference_px)
        known = np.isfinite(reference_px).all(axis=1)
        self._terms = np.column_stack([self._rays, _curved(self._rays, known)])
        self._bow_m = bow_m
        self._views = SharedReference(reference_px, 6)
        self._latest_ns: int | None = None

    def surface(self, tof: Plane, bow: Curvature | None) -> Surface:
        """As it is known now, with the plane that the ToF sensor saw, and the curvature about it if that counts."""
        z2 = tof.d**2
        reach = np.nanmax(np.abs(self._terms[:, :2]), axis=0)
        accuracy = np.diag([*(TOF_ERROR_M / z2 / reach) ** 2, 0.0])
        prior = np.zeros((6, 6))
        prior[:3, :3] = np.linalg.inv(tof.inverse_depth_covariance() + accuracy)
        prior[3:, 3:] = np.eye(3) * (z2 / self._bow_m) ** 2
        weighed = prior[:, :3] @ tof.inverse_depth + self._views.weighed
        if bow is not None:
            by_curvature = self._by_curvature(tof)
            seen = np.linalg.inv(by_curvature @ (bow.covariance + bow.systematic) @ by_curvature.T)
            prior[3:, 3:] += seen
            weighed[3:] += seen @ by_curvature @ bow.values
        covariance = np.linalg.inv(prior + self._views.information)
        mean = covariance @ weighed
        return Surface(self._camera, self._rays, self._terms, mean, covariance)

    def _by_curvature(self, plane: Plane) -> Array:
        """(3, 3), how the curved part of `inverse_depth` goes with the curvature about a plane."""
        known = np.isfinite(self._terms).all(axis=1)
        points = plane.points(self._rays[known])
        x, y = (points @ tangents(plane.normal)).T
        height = np.column_stack([x * x / 2, x * y, y * y / 2])
        # to first order a height moves the depth along the ray by height / (n . ray)
        farther = -height / (points[:, 2] * (points @ plane.normal))[:, None]
        return np.linalg.lstsq(self._terms[known], farther, rcond=None)[0][3:]

    def learn(
        self,
        tof: Plane,
        bow: Curvature | None,
        moved_px: Array,
        sigma_px: Array,
        fixed: NDArray[np.intp],
        shared: float,
        seed: Array,
    ):
        """Take in a view.

        Args:
            moved_px, sigma_px: (N, 2). fixed: (M,), the subsets of the fixed region that were found.
            shared: how many subsets see the same noise, as they overlap.
            seed: (3, 3), homography reference -> image, ideal pixels.

        Raises:
            MeasurementError: if the motion of the fixed region cannot be estimated.
        """
        now = self.surface(tof, bow)
        region, seen, sigma, every = now.part(fixed), moved_px[fixed], sigma_px[fixed], np.arange(len(fixed))
        pose, _, weights, misfit_px = region.fit_pose(seen, sigma, every, seed, self._robust_sigmas)
        R, t = pose
        residual = seen - self._camera.project(region.points() @ R.T + t)
        by_pose, by_shape = region.by_shape(pose)
        misfit = misfit_px**2
        counted = np.maximum(shared, len(fixed) / INDEPENDENT * misfit / (sigma**2 + misfit))
        weights = weights * (sigma**2 + misfit) / ((1 - REFERENCE_PART) * sigma**2 + misfit) / counted
        told = ShapeEvidence(
            now,
            now.inverse_depth,
            fixed,
            sigma * np.sqrt(shared),
            seed,
            residual,
            weights,
            by_shape,
            by_pose,
            np.zeros((6, 6)),
        )
        self._take_in(told, 1.0)

    def learn_beside_deformation(self, told: ShapeEvidence, stamp_ns: int) -> None:
        """Take in a view of a region that deforms. What deforms, deforms alike in views that are near in time, so only
        as much of them counts as there are times DEFORMS_ALIKE_S."""
        passed_s = math.inf if self._latest_ns is None else abs(stamp_ns - self._latest_ns) * 1e-9
        self._latest_ns = stamp_ns
        share = min(1.0, passed_s / DEFORMS_ALIKE_S)
        self._take_in(told, share)

    def _take_in(self, told: ShapeEvidence, share: float) -> None:
        """The normal equations of the shape and of the reference's noise; the other unknowns are eliminated (Schur
        complement)."""
        carried = homography_jacobian(told.seed, self._reference_px[told.subsets])
        sought = np.concatenate([told.by_shape, self._views.by_error(told.subsets, carried)])
        by_all = np.concatenate([sought, told.by_others]).reshape(len(sought) + len(told.by_others), -1)
        weighted = by_all * told.weights.ravel()
        matrix, right, n = weighted @ by_all.T, weighted @ told.residual_px.ravel(), len(sought)
        onto_others = np.linalg.solve(matrix[n:, n:] + told.stiffness, matrix[n:, :n])
        left = matrix[:n, :n] - onto_others.T @ matrix[n:, :n]
        right = right[:n] - onto_others.T @ right[n:] + left[:, : len(told.before)] @ told.before
        self._views.add(share * left, share * right, told.subsets, told.sigma_px**2)


def _curved(rays: Array, known: NDArray[np.bool_]) -> Array:
    """(N, 3), x^2, x y and y^2 of the rays, each less the plane through it and at most 1 (subsets that are known)."""
    x, y = rays[:, 0], rays[:, 1]
    curved = np.column_stack([x * x, x * y, y * y])
    planes = np.linalg.lstsq(rays[known], curved[known], rcond=None)[0]
    curved = curved - rays @ planes
    return curved / np.abs(curved[known]).max(axis=0)
