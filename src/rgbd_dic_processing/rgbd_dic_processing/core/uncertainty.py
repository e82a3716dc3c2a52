"""How errors of neighbouring subsets, and of the compensation, reach a mean over many subsets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.columns import columns
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

Array = NDArray[np.float64]


def overlap_correlation(
    centres_px: Array, subset_px: float, members: NDArray[np.intp] | slice = slice(None)
) -> csr_matrix:
    """Correlation (N, N) of the errors of subsets that share pixels; zero for those that are not members.

    White noise in the image makes the errors of two subsets correlate as the share of pixels that they have in
    common, (1 - |dx|/L)(1 - |dy|/L); so a mean over N overlapping subsets is less certain than sigma / sqrt(N).
    """
    centres = np.asarray(centres_px, float)
    every = np.arange(len(centres))[members]
    near = cKDTree(centres[every]).query_pairs(subset_px - 1e-9, p=np.inf, output_type="ndarray")
    first, second = every[near.T]
    share = np.prod(1 - np.abs(centres[first] - centres[second]) / subset_px, axis=1)
    return csr_matrix(
        (
            np.concatenate([np.ones(len(every)), share, share]),
            (np.concatenate([every, first, second]), np.concatenate([every, second, first])),
        ),
        shape=(len(centres), len(centres)),
    )


def overlaps(correlation: csr_matrix, chosen: NDArray[np.intp], weights: Array | float = 1.0) -> Array | float:
    """sum_ij w_i C_ij w_j over chosen subsets (M,), w (M,) or (M, k): what `correlation[chosen][:, chosen]` gives."""
    every = np.zeros((correlation.shape[0], *np.shape(weights)[1:]))
    every[chosen] = weights
    return np.sum(every * (correlation @ every), axis=0)


def linear_modes(
    sensitivity: Array, sigma: Array, correlation: csr_matrix, chosen: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Independent errors of parameters that depend linearly on the coordinates of chosen subsets.

    Args:
        sensitivity: (p, M, 2), d parameter / d coordinate; x and y errors are taken as independent.
        sigma: (N, 2) standard uncertainties of the coordinates of all subsets.
        correlation: `overlap_correlation` (N, N).
        chosen: indices (M,) of the subsets that the parameters depend on.

    Returns:
        modes: (k, p), as of `independent_modes`; the error of the parameters is sum z_m modes[m], z of unit variance.
        coupling: (k, N, 2), the covariance of z_m with the error of each subset's coordinates. The same noise acts on
            a subset directly and through the parameters; without this the two would be taken as independent.
    """
    count, subsets = len(sensitivity), correlation.shape[0]
    direct = np.zeros((subsets, 2 * count))  # of a subset all by x, then all by y
    direct[chosen] = (sensitivity * sigma[chosen]).transpose(1, 2, 0).reshape(len(chosen), -1)
    spread = correlation @ direct
    products = direct[chosen].T @ spread[chosen]
    modes = independent_modes(products[:count, :count] + products[count:, count:])
    to_unit = modes / np.sum(modes**2, axis=1, keepdims=True)
    known = np.nan_to_num(sigma).T
    by_x, by_y = ((to_unit @ spread[:, i * count : (i + 1) * count].T) * known[i] for i in (0, 1))
    return modes, columns(by_x, by_y)


def independent_modes(covariance: Array) -> Array:
    """Vectors (k, p), one standard deviation each and independent, whose outer products sum to the covariance.

    They are orthogonal to each other.
    """
    values, vectors = np.linalg.eigh(covariance)
    kept = values > max(values[-1], 0) * 1e-12
    return (vectors[:, kept] * np.sqrt(values[kept])).T


def least_squares(design: Array, values: Array) -> Array:
    """x (p, k) for which design (n, p) @ x is nearest to values (n, k); the columns are scaled to the same length.

    By the normal equations, in a tenth of the time of a singular value decomposition, which matters for each image: the
    few parameters of what a panel does to pixels are well apart.
    """
    scale = np.sqrt(np.sum(design**2, axis=0))
    scaled = design / scale
    return np.linalg.solve(scaled.T @ scaled, scaled.T @ values) / scale[:, None]


def quadratic_terms(points_m: Array) -> Array:
    """(N, 6): [1, x, y, x^2, x y, y^2] of points (N, 2)."""
    x, y = points_m[:, 0], points_m[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
