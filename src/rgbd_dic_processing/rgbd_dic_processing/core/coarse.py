"""Where the panel went since a known view: on a reduced image, as a whole by its phase, then block by block."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from .geometry import apply_homography

Array = NDArray[np.float64]


class CoarseSearch:
    """Follows a panel that jumped: any shift up to half the image, a turn of 2 degrees, 3 % of scale.

    The panel of the reference, on its own, is warped as it was last seen and compared with the image, both reduced to
    about 256 cells. Phase correlation (Kuglin and Hines 1975) gives the shift of the whole in 1 ms. Normalised
    cross-correlation of blocks around it gives, in another 2 ms, the points from which a homography follows.
    """

    CELLS = 256  # of the longer side
    HALF = 7  # half side of a block [cells]: it still correlates when turned by one cell in 7, 8 degrees
    REACH = 6  # how far a block is sought after a jump, per axis [cells]
    REACH_APART = 12  # and how far in a panel whose parts moved apart [cells]
    MIN_RESPONSE = 0.05  # of the phase correlation: 0.02 without the panel, at most 0.09; 0.1 with a quarter of it
    MIN_NCC = 0.4  # of a block; that of a wrong place is about 0.25 in fine speckle

    def __init__(self, reference: NDArray[np.uint8], centres_px: Array, subset_size: int):
        """The panel is where the subsets are."""
        rows, cols = reference.shape
        factor = math.ceil(max(rows, cols) / self.CELLS)
        self._size = (max(cols // factor, 1), max(rows // factor, 1))
        self._cell = np.array([cols / self._size[0], rows / self._size[1]])  # [px]
        to_cells = np.diag([*1 / self._cell, 1.0])
        to_cells[:2, 2] = (0.5 / self._cell) - 0.5
        self._to_cells = to_cells
        half = subset_size / 2
        low = np.maximum(np.ceil(self._in_cells(centres_px.min(axis=0) - half)), 0).astype(int)
        high = np.ceil(self._in_cells(centres_px.max(axis=0) + half)).astype(int)
        inside = np.s_[low[1] : high[1], low[0] : high[0]]
        reduced = self._reduced(reference)
        self._panel = np.zeros_like(reduced)
        if reduced[inside].size:
            self._panel[inside] = reduced[inside] - reduced[inside].mean()

    def jumped(self, image: NDArray[np.uint8], view: Array, points_px: Array) -> tuple[Array, Array]:
        """Points of the panel and where they are now, if it jumped away from a view of it.

        Args:
            view: (3, 3) homography reference -> image, as if the lens had no distortion.
            points_px: (M, 2) of the reference around which blocks are compared.

        Returns:
            (K, 2) pixels in the reference, near some of the points, and (K, 2) in the image; K = 0 if not found.
        """
        panel, reduced = self._seen(view), self._reduced(image)
        shift, response = cv2.phaseCorrelate(panel, reduced - reduced.mean())
        if not response >= self.MIN_RESPONSE:
            return np.zeros((0, 2)), np.zeros((0, 2))
        shifts = np.broadcast_to(np.array(shift), points_px.shape)
        source, moved, _ = self._blocks(panel, reduced, view, points_px, shifts, self.REACH)
        return source, moved

    def moved_apart(
        self, image: NDArray[np.uint8], view: Array, points_px: Array, offsets_px: Array
    ) -> tuple[Array, Array, NDArray[np.intp]]:
        """The same for parts of a panel in view that are expected offsets_px (M, 2) away from where the view has them.

        Returns:
            As `jumped`, and which of the points (K,) were found.
        """
        shifts = offsets_px / self._cell
        return self._blocks(self._seen(view), self._reduced(image), view, points_px, shifts, self.REACH_APART)

    def _blocks(
        self, panel: NDArray, image: NDArray, view: Array, points_px: Array, shifts: Array, reach: int
    ) -> tuple[Array, Array, NDArray[np.intp]]:
        """Blocks of the panel found in the image, both in cells, near their places plus the shifts (M, 2) [cells]."""
        half, around = self.HALF, self.HALF + reach
        at = self._in_cells(apply_homography(view, points_px))
        known = np.flatnonzero(np.isfinite(at + shifts).all(axis=1))
        at = np.rint(at[known]).astype(int)
        to = at + np.rint(shifts[known]).astype(int)
        inside = np.all((at >= half) & (at < np.array(self._size) - half), axis=1)
        inside &= np.all((to >= around) & (to < np.array(self._size) - around), axis=1)
        found, moved = [], []
        for index in np.flatnonzero(inside):
            (x, y), (u, v) = at[index], to[index]
            block = panel[y - half : y + half + 1, x - half : x + half + 1]
            window = image[v - around : v + around + 1, u - around : u + around + 1]
            score = cv2.matchTemplate(window, block, cv2.TM_CCOEFF_NORMED)
            _, best, _, (i, j) = cv2.minMaxLoc(score)
            if best >= self.MIN_NCC and 0 < i < 2 * reach and 0 < j < 2 * reach:
                found.append(index)
                moved.append((u + _peak(score[j, i - 1 : i + 2], i), v + _peak(score[j - 1 : j + 2, i], j)))
        found = np.array(found, int)
        source = apply_homography(np.linalg.inv(view), self._in_px(at[found].astype(float)))
        return source, self._in_px(np.reshape(moved, (-1, 2)) - reach), known[found]

    def _seen(self, view: Array) -> NDArray[np.float32]:
        """The panel alone, about zero, as a view (3, 3) shows it [cells]."""
        view = self._to_cells @ view @ np.linalg.inv(self._to_cells)
        return cv2.warpPerspective(self._panel, view, self._size)

    def _reduced(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        return cv2.resize(image, self._size, interpolation=cv2.INTER_AREA).astype(np.float32)

    def _in_cells(self, points_px: Array) -> Array:
        return (points_px + 0.5) / self._cell - 0.5

    def _in_px(self, cells: Array) -> Array:
        return (cells + 0.5) * self._cell - 0.5


def _peak(scores: NDArray[np.float32], middle: int) -> float:
    """Vertex of the parabola through three scores, of which the middle one, at `middle`, is the largest."""
    before, here, after = (float(score) for score in scores)
    bend = before - 2 * here + after
    return middle + (0.5 * (before - after) / bend if bend < 0 else 0.0)
