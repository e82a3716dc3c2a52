"""What a solver is given (`FrameView`) and what it returns: the camera's motion, with its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.columns import columns
from scipy.sparse import csr_matrix

from ..error_sources import ErrorSource
from ..geometry import Plane, apply_homography, pose_from_homography
from ..realignment import Realignment

if TYPE_CHECKING:
    from ..bulge import Bulge
    from ..panel_surface import Surface
    from ..plane_change import PlaneChange
    from ..surface_estimate import ShapeEvidence

Array = NDArray[np.float64]
MEDIAN_LENGTH = 1.1774  # of a normal residual in two dimensions, in standard deviations


@dataclass(frozen=True)
class PanelGeometry:
    """N subsets on the reference's plane, in axes of the crack: x across it, y along it, origin at its point.

    points_m: (N, 2). right, astride: (N,), those right of the crack's line, and those that see both sides of it.
    axes: (3, 2), x and y in the camera's frame.
    """

    points_m: Array
    right: NDArray[np.bool_]
    astride: NDArray[np.bool_]
    axes: Array


@dataclass(frozen=True)
class FrameView:
    """One frame as the solvers see it. Pixels are ideal (undistorted), N subsets.

    reference_px, moved_px: (N, 2); moved_px is NaN where the subset was not found.
    sigma_px: (N, 2), standard uncertainty of moved_px.
    fixed: indices of the fixed region's subsets that were found.
    reference_plane: the panel in the reference frame.
    plane: the panel in this frame, from the paired ToF frame; None if there is none.
    seed: homography (3, 3) reference -> image that the DIC started from.
    panel: where the subsets are on the panel; None for h_pose, which need not know.
    carried: the pose (R, t) along which `plane` was carried from planes of the reference; None if it was not.
    surface: the panel's shape, for a solver that refines it; None where it is flat, or is taken off moved_px already.
    changes: `PlaneChanges.at_image` of this frame; None for a solver that does not ask.
    bulge: what a loaded panel may stand out since the reference; None if it does not.
    known_pose: a plane and `seed_pose` of it, if it was needed before.
    """

    camera: Camera
    reference_px: Array
    moved_px: Array
    sigma_px: Array
    fixed: NDArray[np.intp]
    correlation: csr_matrix
    reference_plane: Plane
    plane: Plane | None
    seed: Array
    panel: PanelGeometry | None
    carried: tuple[Array, Array] | None = None
    surface: Surface | None = None
    changes: Callable[[tuple[Array, Array], Array, Array], PlaneChange | None] | None = None
    bulge: Bulge | None = None
    known_pose: tuple[Plane, tuple[Array, Array]] | None = None

    @cached_property
    def seed_pose(self) -> tuple[Array, Array]:
        """The pose (R, t) that the seed is, of the reference plane."""
        if self.known_pose is not None and self.known_pose[0] is self.reference_plane:
            return self.known_pose[1]
        return pose_from_homography(self.camera, self.seed, self.reference_plane)

    def with_reference_plane(self, reference_plane: Plane) -> FrameView:
        """The frame as it would be with another reference plane: a plane that was carried to it moves along."""
        plane = self.plane
        if self.carried is not None:
            apart = plane.inverse_depth - self.reference_plane.moved(*self.carried).inverse_depth
            plane = Plane.from_inverse_depth(reference_plane.moved(*self.carried).inverse_depth + apart)
        return replace(self, reference_plane=reference_plane, plane=plane)


@dataclass(frozen=True)
class HomographyMotion:
    """Reference -> image by a homography of ideal pixels; its inverse brings the moved centres back (Eq. 2.5)."""

    homography: Array

    def move(self, reference_px: Array) -> Array:
        """Ideal pixels (N, 2) of the reference -> of the image, for points that move with the fixed region."""
        return apply_homography(self.homography, reference_px)

    def panel_points(self, moved_px: Array, realignment: Realignment) -> Array:
        """Moved centres (N, 2), camera motion removed, in the panel frame (N, 3) [m]; z is NaN."""
        in_plane = apply_homography(realignment.homography @ np.linalg.inv(self.homography), moved_px)
        return columns(*in_plane.T, np.full(len(in_plane), np.nan))

    def reference_points(self, reference_px: Array, realignment: Realignment) -> Array:
        """The centres in the reference, in the panel frame (N, 3) [m]; z is NaN."""
        in_plane = realignment.from_pixels(reference_px)
        return columns(*in_plane.T, np.full(len(in_plane), np.nan))


@dataclass(frozen=True)
class RigidMotion:
    """Reference -> image frame by X' = R X + t [m]; the points of both frames lie on the planes of their ToF frames."""

    camera: Camera
    R: Array
    t: Array
    reference_plane: Plane
    plane: Plane

    def move(self, reference_px: Array) -> Array:
        """As `HomographyMotion.move`."""
        points = self.reference_plane.points(self.camera.rays(reference_px))
        return self.camera.project(points @ self.R.T + self.t)

    def panel_points(self, moved_px: Array, realignment: Realignment) -> Array:
        """Moved centres (N, 2), rigid transform undone, in the panel frame (N, 3) [m] (thesis 2.3.3)."""
        points = self.plane.points(self.camera.rays(moved_px))
        return realignment.from_points((points - self.t) @ self.R)

    def reference_points(self, reference_px: Array, realignment: Realignment) -> Array:
        """The centres in the reference, in the panel frame (N, 3) [m]."""
        return realignment.from_points(self.reference_plane.points(self.camera.rays(reference_px)))


Motion = HomographyMotion | RigidMotion


def panel_points_of(motions: Sequence[Motion], moved_px: Array, realignment: Realignment) -> Array:
    """`panel_points` of each (k, N, 3). Homographies are done at once, which costs a fraction."""
    if motions and all(isinstance(motion, HomographyMotion) for motion in motions):
        back = np.linalg.inv(np.stack([motion.homography for motion in motions]))
        in_plane = np.moveaxis(apply_homography(realignment.homography @ back, moved_px), -1, 0)
        return columns(*in_plane, np.full(in_plane.shape[1:], np.nan))
    points = [motion.panel_points(moved_px, realignment) for motion in motions]
    return np.array(points).reshape(-1, len(moved_px), 3)


@dataclass(frozen=True)
class Compensation:
    """The motion of one frame.

    modes: the motion again, once for each independent error of one standard deviation; whatever is computed from
        `motion` has the variance sum (f(mode) - f(motion))^2 from the compensation.
    sources: what causes each of these errors; the first ones, as many as `coupling` has, are MOTION.
    coupling: (k, N, 2), covariance of the first k modes' unit errors with the errors of the subsets' moved_px: these
        modes come from the DIC's noise. The other modes, from the planes, have none.
    residual_px: RMS of the reprojection error of the fixed region's subsets that agree with the motion.
    misfit_px: standard deviation of what the subsets move beside the motion and the DIC's noise, on each axis; it adds
        in quadrature to the uncertainty of every subset.
    shape: the panel's shape if the solver refined it, and what the frame told of it; `motion` and `modes` are of its
        plane. pose: (R, t) that goes with it. bulge: what the panel stands out since the reference.
    """

    motion: Motion
    modes: tuple[Motion, ...]
    sources: tuple[ErrorSource, ...]
    coupling: Array
    residual_px: float
    misfit_px: float = 0.0
    shape: ShapeEvidence | None = None
    pose: tuple[Array, Array] | None = None
    bulge: Bulge | None = None


def reprojection_rms(motion: Motion, view: FrameView, used: NDArray[np.intp]) -> float:
    """RMS distance [px] between where the used subsets are and where the motion puts them."""
    error = view.moved_px[used] - motion.move(view.reference_px[used])
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def misfit_of(residual_px: Array, sigma_px: Array) -> float:
    """Standard deviation [px] that residuals (M, 2) have on each axis beside their uncertainty (M, 2).

    The median length of a normal residual in two dimensions is 1.1774 sigma (Rayleigh); zero if it is not longer. The
    more misfit, the shorter is each residual in units of its standard deviation, so the misfit that makes the median as
    long as it should be is the median of those that make each residual so long.
    """
    return math.sqrt(misfit_variance(residual_px.T, sigma_px.T**2))


def misfit_variance(residual_px: Array, variance_px2: Array) -> float:
    """The square of `misfit_of` [px^2], from residuals (2, M) and the variances that go with them (2, M)."""
    squared_x, squared_y = residual_px**2
    of_x, of_y = variance_px2
    length2 = MEDIAN_LENGTH**2
    # sum of squared / (variance + v) = length2, for v the misfit's variance: length2 v^2 + 2 half v + constant = 0
    half = (length2 * (of_x + of_y) - (squared_x + squared_y)) / 2
    constant = length2 * (of_x * of_y) - (squared_x * of_y + squared_y * of_x)
    root = (-half + np.sqrt(np.maximum(half**2 - length2 * constant, 0))) / length2
    middle = [(len(root) - 1) // 2, len(root) // 2]  # whose mean is the median
    return max(0.0, float(np.partition(root, middle)[middle].mean()))
