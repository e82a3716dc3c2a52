"""What a misplaced measuring zone does to the opening, for both ways of giving zones (thesis 4.4.2, Figure 4.18).

Two rectangles are drawn one by one, so one may be off while the other is right: the opening changes by the gradient of
the displacement in that zone. Two zones from a point on the crack move together: of the two gradients only their
difference counts, and in a panel that deforms alike on both sides it vanishes across the crack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError
from scipy.ndimage import map_coordinates

from ..core.crack import steady
from ..core.displacement_field import DisplacementField
from ..core.regions import CrackZones

Array = NDArray[np.float64]

REACH_PX = 5
MIN_SUBSETS = 3  # in a zone; less do not tell its gradient
LEFT, RIGHT, BOTH = "left rectangle", "right rectangle", "both, by the point"
ACROSS, ALONG = "across", "along"


@dataclass(frozen=True)
class Misplacement:
    """Opening with zones that are off by a shift across the crack (positive to the right) or along it.

    moved: LEFT or RIGHT, one of two independent rectangles; or BOTH, zones from a crack point. axis: ACROSS or ALONG.
    shift_px: (k,) in the reference image. opening_m: (k,) [m]. slope: of the line that fits best [m/px].
    """

    moved: str
    axis: str
    shift_px: Array
    opening_m: Array
    slope: float


def zone_sensitivity(field: DisplacementField, zones: CrackZones, reach_px: int = REACH_PX) -> list[Misplacement]:
    """The opening as a function of where the zones are, up to `reach_px` off in steps of one pixel.

    The subsets of each zone are shifted and the map is interpolated linearly between its subsets, so the response to a
    linear displacement is exact. Subsets that at some shift come to lie where the map has no value take no part, nor
    do those that `core.crack` leaves out. The direction of the crack is the one where the zones are.

    Raises:
        RgbdDicError: if fewer than MIN_SUBSETS subsets of a zone are left.
    """
    shifts = np.arange(-reach_px, reach_px + 1.0)
    centres = field.centres_px.astype(float)
    found = np.isfinite(field.displacement_m[:, :2]).all(axis=1)
    members = [zone[found[zone]] for zone in zones.members(centres)]
    kept = [steady(field, zone) for zone in members]
    across = _across(field, zones, kept)
    normal_m = field.displacement_m[:, :2] @ across
    for zone, left in zip(members, kept, strict=True):
        normal_m[np.setdiff1d(zone, left)] = np.nan
    grid = _Grid.of(centres, normal_m)
    directions = {ACROSS: zones.normal, ALONG: zones.direction}
    means = {
        (side, axis): _zone_means(grid, centres[zone] + (shifts[:, None] * direction)[:, None], side)
        for side, zone in zip((LEFT, RIGHT), kept, strict=True)
        for axis, direction in directions.items()
    }
    middle = reach_px
    results = []
    for axis in directions:
        left, right = means[LEFT, axis], means[RIGHT, axis]
        openings = {LEFT: right[middle] - left, RIGHT: right - left[middle], BOTH: right - left}
        for moved, opening in openings.items():
            results.append(Misplacement(moved, axis, shifts, opening, float(np.polyfit(shifts, opening, 1)[0])))
    return results


def _across(field: DisplacementField, zones: CrackZones, kept: list[NDArray[np.intp]]) -> Array:
    """Unit vector (2,) across the crack in panel axes: the image's direction by the affine map of both zones."""
    some = np.concatenate(kept)
    some = some[np.isfinite(field.position_m[some, 0])]
    if len(some) < 2 * MIN_SUBSETS:
        raise RgbdDicError(f"{len(some)} subsets in the measuring zones, at least {2 * MIN_SUBSETS} are needed")
    terms = np.column_stack([field.centres_px[some].astype(float), np.ones(len(some))])
    to_panel = np.linalg.lstsq(terms, field.position_m[some], rcond=None)[0][:2]
    along = zones.direction @ to_panel
    return np.array([along[1], -along[0]]) / np.linalg.norm(along)


@dataclass(frozen=True)
class _Grid:
    """Values of the subsets on their lattice (rows, cols), 0 where there is none, and where there is one."""

    first_px: Array
    step_px: float
    values: Array
    known: Array

    @classmethod
    def of(cls, centres_px: Array, values: Array) -> _Grid:
        step = min(float(np.diff(np.unique(coordinates)).min(initial=np.inf)) for coordinates in centres_px.T)
        first = centres_px.min(axis=0)
        column, row = np.round((centres_px - first) / step).astype(int).T
        grid = np.full((row.max() + 1, column.max() + 1), np.nan)
        grid[row, column] = values
        known = np.isfinite(grid)
        return cls(first, step, np.where(known, grid, 0.0), known.astype(float))

    def at(self, points_px: Array) -> Array:
        """Linear interpolation at points (..., 2); NaN where a subset that it needs has no value."""
        place = np.moveaxis((points_px - self.first_px)[..., ::-1] / self.step_px, -1, 0)
        # one cell of nothing around, as what lies beyond the border has no value
        values, known = (
            map_coordinates(np.pad(array, 1), place + 1, order=1, mode="constant")
            for array in (self.values, self.known)
        )
        return np.where(known > 1 - 1e-9, values, np.nan)


def _zone_means(grid: _Grid, points_px: Array, side: str) -> Array:
    """Mean at each shift (k,) of the subsets (k, n, 2) that have a value at all of them."""
    values = grid.at(points_px)
    usable = np.isfinite(values).all(axis=0)
    if usable.sum() < MIN_SUBSETS:
        raise RgbdDicError(
            f"{usable.sum()} subsets of the {side} have a displacement wherever they are shifted to, at least "
            f"{MIN_SUBSETS} are needed: the zone is too small or too near the edge of the panel or the crack"
        )
    return values[:, usable].mean(axis=1)
