"""IC-GN of one subset in NumPy and SciPy, double precision: the slow twin that the kernel is held to.

Written for clarity and along another path than the kernel: the eight-parameter problem is solved as it stands,
affine maps are 3 x 3 matrices, the seed map is evaluated at the warped offsets, samples and gradients come from
SciPy's splines, and what noise does to products of gradients from the gradients of an image of one bright pixel.
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


def smoothed_gradient(image: np.ndarray, degree: int, smoothing_px: float) -> tuple[np.ndarray, np.ndarray]:
    """The same of the image smoothed by a Gaussian."""
    if smoothing_px > 0:
        reach = int(np.ceil(4 * smoothing_px))
        image = ndimage.gaussian_filter(image.astype(float), smoothing_px, mode="mirror", radius=reach)
    return gradient(image, degree)


def noise_in_products(degree: int, smoothing_px: float) -> tuple[float, float]:
    """Variance that white noise of unit variance gives J squared, and covariance that it gives J and D, along x."""
    impulse = np.zeros((101, 101))
    impulse[50, 50] = 1
    jx, dx = smoothed_gradient(impulse, degree, smoothing_px)[0], gradient(impulse, degree)[0]
    return float(np.sum(jx * jx)), float(np.sum(jx * dx))


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
    smoothing_px: float = 0.8,
) -> TwinResult:
    """One subset that converges; `seed` is (2, 6)."""
    half = subset_size // 2
    window = np.s_[centre[1] - half : centre[1] + half + 1, centre[0] - half : centre[0] + half + 1]
    offsets = np.arange(-half, half + 1.0)
    xi, eta = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    f = reference[window].astype(float).ravel()
    f = f - f.mean()

    def columns(gradients: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        fx, fy = (derivative[window].ravel() for derivative in gradients)
        return np.stack([fx, fx * xi, fx * eta, fy, fy * xi, fy * eta, np.ones_like(f), f], axis=1)

    design = columns(gradient(reference, degree))
    weights = columns(smoothed_gradient(reference, degree, smoothing_px))
    inverse = np.linalg.inv(weights.T @ design)
    coefficients = ndimage.spline_filter(target.astype(float), order=degree, mode="mirror")

    # Share of noise in the diagonals of J^T J and J^T D, J orthogonal to the constant and f, per noise variance.
    nuisance = weights[:, 6:]
    free = weights - nuisance @ np.linalg.lstsq(nuisance, weights)[0]
    noise_jj, noise_jd = (
        f.size * noise / np.diag(free.T @ other)[[0, 3]]
        for noise, other in zip(noise_in_products(degree, smoothing_px), (free, design), strict=True)
    )

    affine = np.eye(3)
    iterations, left, relaxation, length, last_edge = 0, np.inf, 1.0, np.inf, np.zeros(6)
    while not left < tolerance_px:
        assert iterations < max_iterations, f"no convergence within {max_iterations} iterations"
        iterations += 1
        moved_xi, moved_eta, _ = affine @ np.stack([xi, eta, np.ones_like(xi)])
        x, y = seed @ basis(moved_xi, moved_eta)
        g = ndimage.map_coordinates(coefficients, [y, x], order=degree, mode="mirror", prefilter=False)
        g = g - g.mean()
        residual = f - np.linalg.norm(f) / np.linalg.norm(g) * g
        products = weights.T @ residual
        products[7] = 0  # the scale is |f| / |g|, and not less because of the noise in f
        step = -(inverse @ products)[:6]
        edge = step * [1, half, half, 1, half, half]
        noise = min(residual @ residual / (f.size - 8) / 2 * noise_jd.max(), 0.5)
        if iterations == 2:
            relaxation = 1 / (1 - noise)
        elif iterations > 2:
            relaxation = np.clip(
                -relaxation * (edge - last_edge) @ last_edge / np.sum((edge - last_edge) ** 2), 0.5, 2.5
            )
        step = relaxation * step
        increment = np.array([[1 + step[1], step[2], step[0]], [step[4], 1 + step[5], step[3]], [0, 0, 1]])
        affine = affine @ np.linalg.inv(increment)
        length, rate = np.linalg.norm(edge), np.linalg.norm(edge) / length
        rate = {1: 0.1, 2: rate * max(rate - noise, 0) + 2 * noise}.get(iterations, rate)
        last_edge = edge
        left = length * max(rate, 0.002) / (1 - rate) if rate < 0.5 and length < 0.02 else np.inf

    def centre_at(shift: np.ndarray) -> np.ndarray:
        """Where the centre goes when the increment is preceded by a small shift."""
        moved = affine @ [*shift, 1.0]
        return seed @ basis(moved[0], moved[1])

    residual = residual + design[:, :6] @ step  # as it is after the last step
    gain = np.mean(noise_gain(x, degree) * noise_gain(y, degree))
    variance = residual @ residual / (f.size - 8) * 2 / (1 + gain)
    to_shift = inverse[[0, 3]] @ weights.T  # of the residual
    factor = np.sqrt(1 - variance / 4 * noise_jj) / (1 - variance / 2 * noise_jd)
    covariance = variance * (to_shift @ to_shift.T) * np.outer(factor, factor)
    nudge = 1e-4
    jacobian = np.stack([(centre_at(d) - centre_at(-d)) / (2 * nudge) for d in nudge * np.eye(2)], axis=1)
    spread = (1 + 1 / np.linalg.det(jacobian)) / 2  # a pixel of the target is more or less than one of the reference
    sigma_x, sigma_y = np.sqrt(spread * np.diag(jacobian @ covariance @ jacobian.T))
    zncc = f @ g / (np.linalg.norm(f) * np.linalg.norm(g))
    return TwinResult(*centre_at(np.zeros(2)), sigma_x, sigma_y, zncc, iterations)
