"""The shape of the panel from how views differ (parallax): least squares over all of them.

A camera that turns around a panel sees what stands out of its plane shift: by 0.2 mm for 0.8 mm under 15 degrees. What
the ToF sensor knows of the shape is ten times coarser, so the images tell, as far as the camera did turn; before, the
panel is taken for what the ToF sensor's plane says, and its curvature if that is asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .curvature import Curvature, tangents
from .geometry import Plane, homography_jacobian
from .panel_surface import Surface
from .reference_noise import REFERENCE_PART, SharedReference

Array = NDArray[np.float64]

TOF_ERROR_M = 0.004  # by which the ToF sensor's plane may be wrong at the panel's edges, whatever its noise
DEFORMS_ALIKE_S = 0.25  # a structure under a load that changes in a second or more
INDEPENDENT = 10  # parts of the region that a misfit counts for: what deforms, deforms together


@dataclass(frozen=True)
class ShapeView:
    """One view as the shape sees it, to first order: pixels of M subsets, by the shape and by r other unknowns.

    before: (6,), the `inverse_depth` about which. subsets: (M,), which of all they are. seed: (3, 3), homography
    reference -> image, ideal pixels. sigma_px: (M, 2), uncertainty of their places, times the root of how many see the
    same noise. residual_px, weights: (M, 2), what the unknowns explain. by_shape, by_others: (6, M, 2) and (r, M, 2),
    how the pixels move with them. stiffness: (r, r), what is known of the others beforehand, as information.
    """

    before: Array
    subsets: NDArray[np.intp]
    seed: Array
    sigma_px: Array
    residual_px: Array
    weights: Array
    by_shape: Array
    by_others: Array
    stiffness: Array


@dataclass(frozen=True)
class ShapeEvidence:
    """What a method found of the shape beside motion and deformation: the surface as it is known with this view, and
    the view, for those that come after it."""

    surface: Surface
    view: ShapeView


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
        self._reach = np.nanmax(np.abs(self._rays[:, :2]), axis=0)
        self._bow_m = bow_m
        self._views = SharedReference(reference_px, 6)
        self._latest_ns: int | None = None
        self._latest: tuple[Plane, Curvature | None, Surface] | None = None  # what was asked; until a view comes

    def surface(self, tof: Plane, bow: Curvature | None) -> Surface:
        """As it is known now, with the plane that the ToF sensor saw, and the curvature about it if that counts."""
        if self._latest is not None and self._latest[0] is tof and self._latest[1] is bow:
            return self._latest[2]
        z2 = tof.d**2
        accuracy = np.diag([*(TOF_ERROR_M / z2 / self._reach) ** 2, 0.0])
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
        surface = Surface(self._camera, self._rays, self._terms, mean, covariance)
        self._latest = tof, bow, surface
        return surface

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
        view = ShapeView(
            before=now.inverse_depth,
            subsets=fixed,
            seed=seed,
            sigma_px=sigma * np.sqrt(shared),
            residual_px=residual,
            weights=weights,
            by_shape=by_shape,
            by_others=by_pose,
            stiffness=np.zeros((6, 6)),
        )
        self._take_in(view, 1.0)

    def learn_beside_deformation(self, view: ShapeView, stamp_ns: int) -> None:
        """Take in a view of a region that deforms. What deforms, deforms alike in views that are near in time, so only
        as much of them counts as there are times DEFORMS_ALIKE_S."""
        passed_s = math.inf if self._latest_ns is None else abs(stamp_ns - self._latest_ns) * 1e-9
        self._latest_ns = stamp_ns
        share = min(1.0, passed_s / DEFORMS_ALIKE_S)
        self._take_in(view, share)

    def _take_in(self, view: ShapeView, share: float) -> None:
        """The normal equations of the shape and of the reference's noise; the other unknowns are eliminated (Schur
        complement)."""
        carried = homography_jacobian(view.seed, self._reference_px[view.subsets])
        parts = view.by_shape, self._views.by_error(view.subsets, carried), view.by_others
        by_all = np.concatenate([np.swapaxes(part, 1, 2) for part in parts])  # each coordinate together in memory
        by_all = by_all.reshape(len(by_all), -1)
        weighted = by_all * view.weights.T.ravel()
        matrix, right = weighted @ by_all.T, weighted @ view.residual_px.T.ravel()
        n = len(matrix) - len(view.by_others)
        onto_others = np.linalg.solve(matrix[n:, n:] + view.stiffness, matrix[n:, :n])
        left = matrix[:n, :n] - onto_others.T @ matrix[n:, :n]
        right = right[:n] - onto_others.T @ right[n:] + left[:, : len(view.before)] @ view.before
        self._latest = None
        self._views.add(share * left, share * right, view.subsets, view.sigma_px**2)


def _curved(rays: Array, known: NDArray[np.bool_]) -> Array:
    """(N, 3), x^2, x y and y^2 of the rays, each less the plane through it and at most 1 (subsets that are known)."""
    x, y = rays[:, 0], rays[:, 1]
    curved = np.column_stack([x * x, x * y, y * y])
    planes = np.linalg.lstsq(rays[known], curved[known], rcond=None)[0]
    curved = curved - rays @ planes
    return curved / np.abs(curved[known]).max(axis=0)
