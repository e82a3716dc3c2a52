"""Least squares over many views that all share one noise: that of the reference image.

Each view finds a subset relative to the same pixels of the reference. So half of its variance is an error that is the
same in all of them, and only the other half is averaged away by more views. What it does to a smooth shape lies in its
smooth part, which is estimated along: the mean of the views tells it, the differences between them tell the shape.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]

REFERENCE_PART = 0.5  # of the variance of a subset's place: both images are equally noisy
UNSEEN = 1e-9  # of the prior's information, in what the first view's subsets do not tell apart
DEGREE = 4  # of the smooth part, in x and y: the shape and the pose move pixels by polynomials of degree 3


class SharedReference:
    """Normal equations of many views for k parameters p and the smooth part of the subsets' errors in the reference.

    Args:
        reference_px: (N, 2) of the subsets, ideal pixels; NaN for those that the reference lacks.

    Attributes:
        information: (k, k), that the views tell of p. weighed: (k,), its product with their estimate.
    """

    def __init__(self, reference_px: Array, parameters: int) -> None:
        known = np.isfinite(reference_px).all(axis=1)
        low, high = reference_px[known].min(axis=0), reference_px[known].max(axis=0)
        x, y = (2 * (reference_px - low) / np.maximum(high - low, 1) - 1).T
        self._terms = np.array([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
        self.information, self.weighed = np.zeros((parameters, parameters)), np.zeros(parameters)
        self._matrix: Array | None = None
        self._right: Array | None = None

    def by_error(self, subsets: NDArray[np.intp], carried: Array) -> Array:
        """(q, M, 2), how some of the subsets move in a view with the q coefficients of the errors.

        Args:
            carried: (M, 2, 2), d pixel in the view / d pixel in the reference.
        """
        terms = self._terms[:, subsets]
        moved = np.empty((2, len(terms), 2, len(subsets)))  # each coordinate together in memory, as in `columns`
        for error, pixel in np.ndindex(2, 2):
            np.multiply(terms, carried[:, pixel, error], out=moved[error, :, pixel])
        return np.swapaxes(moved.reshape(-1, 2, len(subsets)), 1, 2)

    def add(self, matrix: Array, right: Array, subsets: NDArray[np.intp], variance_px2: Array) -> None:
        """Take in a view.

        Args:
            matrix, right: (k + q, k + q) and (k + q,), its normal equations for p and the coefficients of the errors.
            variance_px2: (M, 2), of the places of its subsets.
        """
        k = len(self.weighed)
        if self._matrix is None:
            self._matrix, self._right = np.zeros_like(matrix), np.zeros_like(right)
            terms = self._terms[:, subsets]
            x, y = ((terms / variance) @ terms.T for variance in REFERENCE_PART * variance_px2.T)
            prior = scipy.linalg.block_diag(x, y)
            self._matrix[k:, k:] = prior + UNSEEN * np.trace(prior) * np.eye(len(prior))
        self._matrix += matrix
        self._right += right
        onto = np.linalg.solve(self._matrix[k:, k:], self._matrix[k:, :k])
        self.information = self._matrix[:k, :k] - onto.T @ self._matrix[k:, :k]
        self.weighed = self._right[:k] - onto.T @ self._right[k:]
