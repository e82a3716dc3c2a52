"""IC-GN of one subset in NumPy and SciPy, double precision: the slow twin that the kernel is held to.

Written for clarity and along another path than the kernel: the eight-parameter least-squares problem is
solved as it stands, affine maps are 3 x 3 matrices, the seed map is evaluated at the warped offsets, samples
and gradients come from SciPy's splines.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import interpolate, ndimage

BORDER_PX = 32
"""The gradient's splines end at the image's edge with another condition than the kernel's; at this distance
the difference has died away (0.43^32 is 2e-12)."""


@dataclasses.dataclass(frozen=True)
class TwinResult:
    x_px: float
    y_px: float
    sigma_x_px: float
    sigma_y_px: float
    zncc: float
    iterations: int


def gradient(image: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives along x and y, grey levels per px, of the interpolating spline at the pixels."""

    def along(axis: int) -> np.ndarray:
        knots = np.arange(image.shape[axis])
        return interpolate.make_interp_spline(knots, image.astype(float), k=degree, axis=axis).derivative()(knots)

    return along(1), along(0)


def noise_gain(position: np.ndarray, degree: int) -> np.ndarray:
    """Variance of spline samples along one axis, if the pixels carry white noise of unit variance."""
    reach = 40
    weights = interpolate.make_interp_spline(np.arange(2 * reach + 1), np.eye(2 * reach + 1), k=degree)
    return (weights(reach + position % 1) ** 2).sum(axis=-1)


def basis(xi: np.ndarray, eta: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(xi), xi, eta, xi**2, xi * eta, eta**2])


def correlate(
    reference: np.ndarray,
    target: np.ndarray,
    centre: tuple[int, int],
    seed: np.ndarray,
    *,
    subset_size: int = 31,
    degree: int = 5,
    max_iterations: int = 20,
    tolerance_px: float = 1e-4,
) -> TwinResult:
    """One subset that converges; `seed` is (2, 6)."""
    half = subset_size // 2
    window = np.s_[centre[1] - half : centre[1] + half + 1, centre[0] - half : centre[0] + half + 1]
    offsets = np.arange(-half, half + 1.0)
    xi, eta = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    f = reference[window].astype(float).ravel()
    f = f - f.mean()
    fx, fy = (derivative[window].ravel() for derivative in gradient(reference, degree))
    design = np.stack([fx, fx * xi, fx * eta, fy, fy * xi, fy * eta, np.ones_like(f), f], axis=1)
    coefficients = ndimage.spline_filter(target.astype(float), order=degree, mode="mirror")

    affine = np.eye(3)
    iterations, converged = 0, False
    while not converged:
        assert iterations < max_iterations, f"no convergence within {max_iterations} iterations"
        iterations += 1
        moved_xi, moved_eta, _ = affine @ np.stack([xi, eta, np.ones_like(xi)])
        x, y = seed @ basis(moved_xi, moved_eta)
        g = ndimage.map_coordinates(coefficients, [y, x], order=degree, mode="mirror", prefilter=False)
        g = g - g.mean()
        residual = f - np.linalg.norm(f) / np.linalg.norm(g) * g
        step = -np.linalg.lstsq(design, residual)[0][:6]
        increment = np.array([[1 + step[1], step[2], step[0]], [step[4], 1 + step[5], step[3]], [0, 0, 1]])
        affine = affine @ np.linalg.inv(increment)
        converged = np.linalg.norm(step * [1, half, half, 1, half, half]) < tolerance_px

    def centre_at(shift: np.ndarray) -> np.ndarray:
        """Where the centre goes when the increment is preceded by a small shift."""
        moved = affine @ [*shift, 1.0]
        return seed @ basis(moved[0], moved[1])

    gain = np.mean(noise_gain(x, degree) * noise_gain(y, degree))
    variance = residual @ residual / (f.size - 8) * 2 / (1 + gain)
    covariance = variance * np.linalg.inv(design.T @ design)[np.ix_([0, 3], [0, 3])]
    nudge = 1e-4
    jacobian = np.stack([(centre_at(d) - centre_at(-d)) / (2 * nudge) for d in nudge * np.eye(2)], axis=1)
    sigma_x, sigma_y = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
    zncc = f @ g / (np.linalg.norm(f) * np.linalg.norm(g))
    return TwinResult(*centre_at(np.zeros(2)), sigma_x, sigma_y, zncc, iterations)
