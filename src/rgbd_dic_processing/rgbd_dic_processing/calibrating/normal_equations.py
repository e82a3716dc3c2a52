"""Least squares over all images: every image's part, the solution with its covariance, and the jackknife.

The normal matrix is summed up image by image: each touches few parameters, so that this takes a hundredth of the time
of a general solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import CalibrationError
from scipy.linalg import cho_factor, cho_solve

from .detection import Found
from .estimate import ImageFit
from .model import Layout, Projection

Array = NDArray[np.float64]

FIRST_NOISE_PX, LEAST_NOISE_PX = 0.1, 1e-4
GROSS = 6.0  # residuals beyond so many robust standard deviations of their image are left out
MOST_STEPS, MOST_HALVINGS = 50, 20
CONVERGED = 1e-4  # length of the last step, in standard deviations of the result
UNDETERMINED = "the boards do not determine the calibration: take more images, at other places and tilts"


class ImageEquations:
    """One image's part in the adjustment: its corners, which of them are kept, and its noise."""

    def __init__(self, view: int, sensor: str, found: Found, points_m: Array) -> None:
        self.view, self.sensor = view, sensor
        self._found, self._points_m = found, points_m
        self._kept, self._noise_px = np.ones(len(points_m), bool), FIRST_NOISE_PX

    def residuals(self, x: Array, layout: Layout) -> tuple[Array, Projection]:
        projection = layout.project(x, self.view, self.sensor, self._points_m)
        return self._found.corners_px - projection.pixels, projection

    def weighted(self, x: Array, layout: Layout) -> tuple[Array, Array, NDArray[np.int64]]:
        """Residuals and derivatives of what is kept, in standard deviations; columns of the derivatives."""
        r, projection = self.residuals(x, layout)
        jacobian = projection.jacobian[np.repeat(self._kept, 2)]
        return r[self._kept].ravel() / self._noise_px, jacobian / self._noise_px, projection.columns

    def reweigh(self, x: Array, covariance: Array, layout: Layout) -> None:
        """Noise from the residuals of the corners that are kept: those within GROSS robust standard deviations."""
        r, _ = self.residuals(x, layout)
        self._kept = np.all(np.abs(r) < GROSS * 1.4826 * np.median(np.abs(r)), axis=1)
        weighted, jacobian, columns = self.weighted(x, layout)
        redundancy = len(weighted) - np.sum((jacobian @ covariance[np.ix_(columns, columns)]) * jacobian)
        noise_px = self._noise_px * float(np.sqrt(np.sum(weighted**2) / redundancy))
        self._noise_px = max(noise_px, LEAST_NOISE_PX)

    def fit(self, x: Array, layout: Layout) -> ImageFit:
        r, _ = self.residuals(x, layout)
        return ImageFit(np.where(self._kept[:, None], r, np.nan), self._noise_px)


class _Normal(NamedTuple):
    """Normal matrix, gradient and sum of weighted squares at some parameters."""

    matrix: Array
    gradient: Array
    cost: float


def _normal(x: Array, images: Sequence[ImageEquations], layout: Layout) -> _Normal:
    matrix, gradient, cost = np.zeros((layout.size, layout.size)), np.zeros(layout.size), 0.0
    for image in images:
        r, jacobian, columns = image.weighted(x, layout)
        matrix[np.ix_(columns, columns)] += jacobian.T @ jacobian
        gradient[columns] += jacobian.T @ r
        cost += float(r @ r)
    return _Normal(matrix, gradient, cost)


def solve(x: Array, images: Sequence[ImageEquations], layout: Layout) -> tuple[Array, Array]:
    """Parameters with the least sum of weighted squares, and their covariance."""
    now = _normal(x, images, layout)
    for _ in range(MOST_STEPS):
        scale = np.sqrt(np.diag(now.matrix))
        try:
            factor = cho_factor(now.matrix / np.outer(scale, scale))
        except (np.linalg.LinAlgError, ValueError) as error:
            raise CalibrationError(UNDETERMINED) from error
        step = cho_solve(factor, now.gradient / scale) / scale
        if now.gradient @ step < CONVERGED**2:
            return x + step, cho_solve(factor, np.eye(layout.size)) / np.outer(scale, scale)
        for _ in range(MOST_HALVINGS):
            after = _normal(x + step, images, layout)
            if after.cost < now.cost:
                break
            step = step / 2
        else:
            break
        x, now = x + step, after
    raise CalibrationError(UNDETERMINED)


def jackknife(x: Array, images: Sequence[ImageEquations], layout: Layout) -> Array:
    """Standard deviations of the parameters from what each view, left out, would change; 0 for the views' poses.

    To first order: with the poses eliminated, view i has the normal matrix N_i and the gradient g_i, and without it the
    parameters move by -(N - N_i)^-1 g_i.
    """
    count = layout.pose(0).start
    views = sorted({image.view for image in images})
    normal, gradient = np.zeros((len(views), count, count)), np.zeros((len(views), count))
    for place, view in enumerate(views):
        N, g, pose = np.zeros((count + 6, count + 6)), np.zeros(count + 6), layout.pose(view)
        for image in images:
            if image.view == view:
                r, jacobian, columns = image.weighted(x, layout)
                columns = np.where(columns < count, columns, columns - pose.start + count)
                N[np.ix_(columns, columns)] += jacobian.T @ jacobian
                g[columns] += jacobian.T @ r
        eliminate = np.linalg.solve(N[count:, count:], N[count:, :count]).T
        normal[place] = N[:count, :count] - eliminate @ N[count:, :count]
        gradient[place] = g[:count] - eliminate @ g[count:]
    total = normal.sum(axis=0)
    scale = np.sqrt(np.diag(total))
    moved = [
        np.linalg.lstsq((total - N) / np.outer(scale, scale), g / scale, rcond=None)[0] / scale
        for N, g in zip(normal, gradient, strict=True)
    ]
    deviations = np.zeros(layout.size)
    deviations[:count] = np.sqrt((len(views) - 1) / len(views) * np.sum(np.square(moved), axis=0))
    return deviations
