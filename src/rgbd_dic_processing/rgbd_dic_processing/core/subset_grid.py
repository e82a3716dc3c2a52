"""Which subsets are next to each other."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

Array = NDArray[np.float64]


class SubsetGrid:
    """Subset centres (N, 2) [px], about one step apart, in any order; NaN has no neighbours."""

    def __init__(self, centres_px: Array, step_px: float):
        self._centres, self._step = centres_px, step_px
        self._known = np.isfinite(centres_px).all(axis=1)
        self._low = centres_px[self._known].min(axis=0)
        self._cell = self._cells_of(np.where(self._known[:, None], centres_px, self._low))
        self._shape = self._cell.max(axis=0) + 1

    @cached_property
    def around(self) -> NDArray[np.intp]:
        """The up to 8 neighbours (N, 8) within a step and a half of each subset, by index; N where there is none."""
        known = np.flatnonzero(self._known)
        tree = cKDTree(self._centres[known])
        near = tree.query(self._centres[known], k=9, distance_upper_bound=1.5 * self._step)[1][:, 1:]
        count = len(self._centres)
        around = np.full((count, 8), count)
        around[known] = np.append(known, count)[near]
        return around

    def nearest(self, members: NDArray[np.bool_], points_px: Array | None = None) -> NDArray[np.intp]:
        """Index of the member (N,) nearest, to a step, to each subset or to each point (M, 2) [px]. One is needed."""
        index = np.full(self._shape, -1)
        index[tuple(self._cell[members].T)] = np.flatnonzero(members)
        nearest = index[tuple(distance_transform_edt(index < 0, return_distances=False, return_indices=True))]
        if points_px is None:  # two may share a cell
            return np.where(members, np.arange(len(members)), nearest[tuple(self._cell.T)])
        return nearest[tuple(np.clip(self._cells_of(points_px), 0, self._shape - 1).T)]

    def median_around(self, values: Array, chosen: NDArray[np.intp]) -> Array:
        """Medians (M, K) of values (N, K) over the neighbours of the chosen (M,); values that are NaN are left out."""
        near = np.sort(np.vstack([values, np.full(values.shape[1:], np.nan)])[self.around[chosen]], axis=1)
        known = np.isfinite(near).sum(axis=1)[:, None]
        low, high = (np.take_along_axis(near, np.maximum(known - 1 + odd, 0) // 2, axis=1)[:, 0] for odd in (0, 1))
        return (low + high) / 2

    def _cells_of(self, points_px: Array) -> NDArray[np.intp]:
        return np.rint((points_px - self._low) / self._step).astype(int)
