"""h_2d: the projective transform that best brings the fixed region's centres back, no depth (thesis 2.3.2).

Fitted to both sides of a crack at once, it takes a part of the opening for motion, for a camera that comes nearer. So
where the region lies on both sides, how these part, slide and turn against each other is estimated along; with
`parting: false` nothing is, as in the thesis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import MeasurementError

from ..deformation import parting_modes
from ..error_sources import ErrorSource
from ..geometry import apply_homography
from ..homography import changed, fit_homography, fit_homography_beside, jacobian_beside
from ..msac import msac
from ..settings import CompensationSettings
from ..uncertainty import linear_modes
from .motion import Compensation, FrameView, HomographyMotion, misfit_of

Array = NDArray[np.float64]


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """Projective MSAC on the fixed region, then least squares of the reprojection error over the inliers.

    The turn of the sides is linearised: one of 0.1 rad against each other stretches both by 0.1 %.

    Raises:
        MeasurementError: if no homography fits enough subsets.
    """
    source, target, right = view.reference_px[view.fixed], view.moved_px[view.fixed], view.panel.right[view.fixed]
    fewest = min(right.sum(), (~right).sum())
    sides = (right, ~right) if settings.parting and fewest >= settings.min_subsets else ()

    def fit(chosen: NDArray[np.intp]) -> Array | None:
        return fit_homography(source[chosen], target[chosen])

    def residuals(homography: Array) -> Array:
        apart = target - apply_homography(homography, source)
        for side in sides:  # what a side moved as a whole does not make it an outlier
            apart[side] -= np.median(apart[side], axis=0)
        return np.linalg.norm(apart, axis=1)

    homography, inliers = msac(len(source), 4, fit, residuals, settings.inlier_px, settings.max_trials)
    if inliers.sum() < settings.min_subsets:
        raise MeasurementError(
            f"h_2d: {inliers.sum()} subsets of the fixed region agree, at least {settings.min_subsets} needed"
        )
    used, found_px = view.fixed[inliers], target[inliers]
    points, to_points, parting = source[inliers], np.eye(3), np.zeros((0, len(used), 2))
    fitted_px = apply_homography(homography, points)
    if sides:  # on the panel, where all of a side moves alike
        points = view.panel.points_m[used]
        to_points, parting = fit_homography(source[inliers], points), parting_modes(points, right[inliers])
        homography, fitted_px = fit_homography_beside(homography @ np.linalg.inv(to_points), points, found_px, parting)
    misfit_px = misfit_of(found_px - fitted_px, view.sigma_px[used])
    jacobian, normalise = jacobian_beside(homography, points, parting)
    normal_matrix = np.einsum("pma,qma->pq", jacobian, jacobian)
    sensitivity = np.einsum("pq,qma->pma", np.linalg.inv(normal_matrix)[:8], jacobian)
    steps, coupling = linear_modes(sensitivity, np.hypot(view.sigma_px, misfit_px), view.correlation, used)
    motion, *modes = (
        HomographyMotion(changed(homography, normalise, step) @ to_points) for step in (np.zeros(8), *steps)
    )
    sources = (ErrorSource.MOTION,) * len(modes)
    residual_px = float(np.sqrt(np.mean(np.sum((found_px - fitted_px) ** 2, axis=1))))
    return Compensation(motion, tuple(modes), sources, coupling, residual_px, misfit_px)
