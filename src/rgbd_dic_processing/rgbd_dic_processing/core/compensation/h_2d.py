"""h_2d: the projective transform that best brings the fixed region's centres back, no depth (thesis 2.3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import MeasurementError

from ..error_sources import ErrorSource
from ..geometry import apply_homography
from ..homography import fit_homography, target_jacobian
from ..msac import msac
from ..settings import CompensationSettings
from ..uncertainty import linear_modes
from .motion import Compensation, FrameView, HomographyMotion, misfit_of, reprojection_rms

Array = NDArray[np.float64]


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """Projective MSAC on the fixed region, then least squares of the reprojection error over the inliers.

    Raises:
        MeasurementError: if no homography fits enough subsets.
    """
    source, target = view.reference_px[view.fixed], view.moved_px[view.fixed]

    def fit(chosen: NDArray[np.intp]) -> Array | None:
        return fit_homography(source[chosen], target[chosen])

    def residuals(homography: Array) -> Array:
        return np.linalg.norm(target - apply_homography(homography, source), axis=1)

    homography, inliers = msac(len(source), 4, fit, residuals, settings.inlier_px, settings.max_trials)
    if inliers.sum() < settings.min_subsets:
        raise MeasurementError(
            f"h_2d: {inliers.sum()} subsets of the fixed region agree, at least {settings.min_subsets} needed"
        )
    used = view.fixed[inliers]
    motion = HomographyMotion(homography)
    misfit_px = misfit_of(view.moved_px[used] - motion.move(view.reference_px[used]), view.sigma_px[used])
    modes, coupling = _modes(homography, view, used, misfit_px)
    sources = (ErrorSource.MOTION,) * len(modes)
    return Compensation(motion, modes, sources, coupling, reprojection_rms(motion, view, used), misfit_px)


def _modes(
    homography: Array, view: FrameView, used: NDArray[np.intp], misfit_px: float
) -> tuple[tuple[HomographyMotion, ...], Array]:
    """The homographies (1 + E) H, E each of the independent errors of the eight parameters; their coupling."""
    target = apply_homography(homography, view.reference_px[used])
    centre, spread = target.mean(axis=0), target.std()
    normalise = np.array([[1 / spread, 0, -centre[0] / spread], [0, 1 / spread, -centre[1] / spread], [0, 0, 1]])
    jacobian = spread * target_jacobian((target - centre) / spread)
    normal_matrix = np.einsum("pma,qma->pq", jacobian, jacobian)
    sensitivity = np.einsum("pq,qma->pma", np.linalg.inv(normal_matrix), jacobian)
    modes, coupling = linear_modes(sensitivity, np.hypot(view.sigma_px, misfit_px), view.correlation, used)
    back = np.linalg.inv(normalise)
    moved = [back @ (np.eye(3) + np.append(mode, 0).reshape(3, 3)) @ normalise @ homography for mode in modes]
    return tuple(HomographyMotion(changed) for changed in moved), coupling
