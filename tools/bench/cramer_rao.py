"""The Cramer-Rao bound of a subset's position: no unbiased estimate from these two images scatters less.

The reference has independent noise of variance s^2 at every pixel, and so has the target. At a subset where the warp
has the Jacobian A (2 x 2), J = det A target pixels fall on one reference pixel. White noise of variance s^2 per target
pixel, carried back to the reference, is white with s^2 / J per reference pixel, within the band of the pattern. The
difference of the two images therefore has the noise s^2 (1 + 1/J), and with the exact gradient g of the pattern and the
steepest-descent row S = [g_x (1, xi, eta), g_y (1, xi, eta)] of the affine increment

    cov(p) = s^2 (1 + 1/J) (sum S^T S)^-1,    cov(position in the target) = A cov(u, v) A^T.

For a translation J = 1: 2 s^2 [(sum S^T S)^-1]_uu. Offset and gain, which the ZNSSD estimates as well, are taken as
known, so the bound is a little lower than any ZNSSD can be.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from speckle import QUANTISATION_VARIANCE, Motion, Speckle, pixels

Array = NDArray[np.float64]


class Texture:
    """What the exact gradients of a pattern say about each of its subsets."""

    def __init__(self, speckle: Speckle, size: int, centres_px: NDArray, subset_size: int) -> None:
        grey, *gradient = (part.reshape(size, size) for part in speckle.with_gradient(*pixels().T))
        self.contrast = float(grey.std())  # grey levels
        self.mean_gradient = float(np.hypot(*gradient).mean())  # grey levels / px
        self.centres_px = np.asarray(centres_px)
        self._inverse = np.linalg.inv(self._normal_matrices(gradient, subset_size))

    def _normal_matrices(self, gradient: list[Array], subset_size: int) -> Array:
        half = subset_size // 2
        columns, rows = (self.centres_px - half).T
        eta, xi = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
        basis = np.stack([np.ones_like(xi), xi, eta])
        products = np.einsum("kij,lij->klij", basis, basis)
        matrices = np.empty((len(self.centres_px), 6, 6))
        for i in range(2):
            for j in range(2):
                windows = sliding_window_view(gradient[i] * gradient[j], (subset_size, subset_size))[rows, columns]
                block = np.tensordot(windows, products, axes=([1, 2], [2, 3]))
                matrices[:, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
        return matrices

    def floor_px(self, motion: Motion, noise: float, chosen: NDArray | slice = slice(None)) -> Array:
        """(2,) RMS over subsets of the bound along x and y of the target [px]; noise: added grey levels."""
        warp = motion.gradient(self.centres_px[chosen].astype(float))
        increments = self._inverse[chosen][:, ::3, ::3] * (1 + 1 / np.linalg.det(warp))[:, None, None]
        covariance = (QUANTISATION_VARIANCE + noise**2) * warp @ increments @ warp.transpose(0, 2, 1)
        return np.sqrt(np.mean(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
