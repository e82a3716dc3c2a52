"""How errors of neighbouring subsets, and of the compensation, reach a mean over many subsets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

Array = NDArray[np.float64]


def overlap_correlation(centres_px: Array, subset_size: int) -> csr_matrix:
    """Correlation (N, N) of the errors of subsets that share pixels.

    White noise in the image makes the errors of two subsets correlate as the share of pixels that they have in
    common, (1 - |dx|/L)(1 - |dy|/L); so a mean over N overlapping subsets is less certain than sigma / sqrt(N).
    """
    centres = np.asarray(centres_px, float)
    first, second = cKDTree(centres).query_pairs(subset_size - 1e-9, p=np.inf, output_type="ndarray").T
    share = np.prod(1 - np.abs(centres[first] - centres[second]) / subset_size, axis=1)
    every = np.arange(len(centres))
    return csr_matrix(
        (
            np.concatenate([np.ones(len(centres)), share, share]),
            (np.concatenate([every, first, second]), np.concatenate([every, second, first])),
        ),
        shape=(len(centres), len(centres)),
    )


def linear_covariance(sensitivity: Array, sigma: Array, correlation: csr_matrix, chosen: NDArray[np.intp]) -> Array:
    """Covariance (p, p) of parameters that depend linearly on the coordinates of chosen subsets.

    Args:
        sensitivity: (p, M, 2), d parameter / d coordinate; x and y errors are taken as independent.
        sigma: (M, 2) standard uncertainties of the chosen subsets' coordinates.
        correlation: `overlap_correlation` (N, N) of all subsets.
        chosen: indices (M,) of the subsets.
    """
    covariance = np.zeros((len(sensitivity), len(sensitivity)))
    for axis in (0, 1):
        scaled = np.zeros((correlation.shape[0], len(sensitivity)))
        scaled[chosen] = (sensitivity[:, :, axis] * sigma[:, axis]).T
        covariance += scaled.T @ (correlation @ scaled)
    return covariance


def independent_modes(covariance: Array) -> Array:
    """Vectors (k, p), one standard deviation each and independent, whose outer products sum to the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > max(values[-1], 0) * 1e-12
    return (vectors[:, kept] * np.sqrt(values[kept])).T


def quadratic_terms(points_m: Array) -> Array:
    """(N, 6): [1, x, y, x^2, x y, y^2] of points (N, 2)."""
    x, y = points_m[:, 0], points_m[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
