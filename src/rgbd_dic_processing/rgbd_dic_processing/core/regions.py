"""The regions that a user draws on the reference image; `regions_file.py` reads and writes them.

All coordinates are pixels of the raw reference image, x right, y down.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RegionsError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class CrackZones:
    """The measuring zones on the two sides of the crack, as polygons (M, 2) [px], and the crack's direction (2,)
    at a point (2,) on it.

    The normal points from left to right; `direction` is a unit vector along the crack such that the normal turned by
    90 degrees from x towards y is the direction.
    """

    left: Array
    right: Array
    point: Array
    direction: Array

    @property
    def normal(self) -> Array:
        """Unit vector (2,) across the crack, from left to right."""
        return np.array([self.direction[1], -self.direction[0]])

    @classmethod
    def from_point(cls, point: Array, direction: Array, across: float, along: float, gap: float) -> CrackZones:
        """Two rectangles, symmetric about the crack line through `point` (thesis 4.4.2).

        Args:
            point: on the crack [px].
            direction: along the crack; either sign, any length.
            across, along: size of each rectangle normal to the crack and along it [px].
            gap: distance of each rectangle's near side from the crack line [px].
        """
        tangent = _oriented(direction)
        normal = np.array([tangent[1], -tangent[0]])
        corners = np.array([(gap, -along / 2), (gap + across, -along / 2), (gap + across, along / 2), (gap, along / 2)])
        right = point + corners[:, :1] * normal + corners[:, 1:] * tangent
        left = point - corners[:, :1] * normal + corners[:, 1:] * tangent
        return cls(left, right, np.asarray(point, float), tangent)

    @classmethod
    def from_rectangles(cls, left: Array, right: Array, direction: Array | None = None) -> CrackZones:
        """Two rectangles [x0, y0, x1, y1] [px]. Without a direction the crack is taken to be at right angles to the
        line between their centres; the normal points from left to right."""
        boxes = [np.array([(b[0], b[1]), (b[2], b[1]), (b[2], b[3]), (b[0], b[3])], float) for b in (left, right)]
        centres = [box.mean(axis=0) for box in boxes]
        between = centres[1] - centres[0]
        tangent = np.array([-between[1], between[0]]) if direction is None else np.asarray(direction, float)
        length = np.linalg.norm(tangent)
        if length == 0:
            raise RegionsError("crack: the two rectangles have the same centre, or the direction is zero")
        tangent = tangent / length
        if np.dot([tangent[1], -tangent[0]], between) < 0:
            tangent = -tangent
        return cls(boxes[0], boxes[1], (centres[0] + centres[1]) / 2, tangent)

    def beyond(self, points_px: Array) -> Mask:
        """Which points (N, 2) lie right of the crack's line."""
        return (points_px - self.point) @ self.normal > 0

    def members(self, points_px: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Indices of the points (N, 2) in the left zone and in the right one."""
        return np.flatnonzero(inside(self.left, points_px)), np.flatnonzero(inside(self.right, points_px))


@dataclass(frozen=True)
class Regions:
    """What regions.yaml holds.

    panel: polygon (M, 2) in which subsets are laid and ToF points are taken for the plane.
    fixed: polygons of the part that is taken as rigid; empty means the whole panel.
    x_axis: two points (2, 2) on the panel's x axis, or None for the principal axes (thesis 2.4).
    crack: the measuring zones, or None where only maps are wanted.
    fixed_holes: polygons that are cut out of the fixed region.
    entries: the entries of regions.yaml that they were read from; empty if they were not.
    """

    panel: Array
    fixed: tuple[Array, ...]
    x_axis: Array | None
    crack: CrackZones | None
    fixed_holes: tuple[Array, ...] = ()
    entries: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def fixed_members(self, points_px: Array) -> Mask:
        """Which points (N, 2) lie in the fixed region."""
        members = np.any([inside(polygon, points_px) for polygon in self.fixed or (self.panel,)], axis=0)
        for hole in self.fixed_holes:
            members &= ~inside(hole, points_px)
        return members

    def check(self, width: int, height: int, subset_size: int, step: int) -> NDArray[np.int32]:
        """Refuse regions that cannot work on an image of this size [px].

        Returns:
            As `subset_centres`.

        Raises:
            RegionsError: naming the region and what is wrong with it.
        """
        named = [("panel", self.panel)] + [(f"fixed[{i}]", p) for i, p in enumerate(self.fixed)]
        named += [(f"fixed_holes[{i}]", p) for i, p in enumerate(self.fixed_holes)]
        if self.crack is not None:
            named += [("crack: left zone", self.crack.left), ("crack: right zone", self.crack.right)]
        if self.x_axis is not None:
            named += [("x_axis", self.x_axis)]
        for name, points in named:
            outside = (points < -0.5) | (points > np.array([width, height]) - 0.5)
            if outside.any():
                x, y = points[outside.any(axis=1)][0]
                raise RegionsError(
                    f"{name} has the point ({x:g}, {y:g}), outside the image of {width} x {height} px: "
                    "draw the regions on this camera's reference image"
                )
        centres = self.subset_centres(width, height, subset_size, step)
        members = [("fixed", self.fixed_members(centres))]
        if self.crack is not None:
            members += [
                ("crack: left zone", inside(self.crack.left, centres)),
                ("crack: right zone", inside(self.crack.right, centres)),
            ]
        for name, member in members:
            if not member.any():
                raise RegionsError(
                    f"{name} holds no subset centre (subsets of {subset_size} px every {step} px inside the panel): "
                    "make it larger, move it into the panel, or choose a smaller step"
                )
        return centres

    def subset_centres(self, width: int, height: int, subset_size: int, step: int) -> NDArray[np.int32]:
        """Centres (N, 2) of the subsets that lie wholly inside the panel, row by row.

        Raises:
            RegionsError: if there is none.
        """
        half = subset_size // 2
        low = np.maximum(np.ceil(self.panel.min(axis=0)).astype(int) + half, half)
        high = np.minimum(np.floor(self.panel.max(axis=0)).astype(int), [width - 1, height - 1]) - half
        xs, ys = np.arange(low[0], high[0] + 1, step), np.arange(low[1], high[1] + 1, step)
        grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
        corners = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        kept = np.all([inside(self.panel, grid + corner) for corner in corners], axis=0)
        if not np.any(kept):
            raise RegionsError(
                f"panel holds no whole subset of {subset_size} px: draw it larger or choose smaller subsets"
            )
        return np.ascontiguousarray(grid[kept], np.int32)


def inside(polygon_px: Array, points_px: Array) -> Mask:
    """Which points (N, 2) lie inside a polygon (M, 2) or on its border: those whose ray to the right crosses it an odd
    number of times."""
    corners = np.asarray(polygon_px, float)
    x, y = np.asarray(points_px, float).T.copy()
    odd, on_border = np.zeros((2, len(x)), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along_x, along_y = x1 - x0, y1 - y0
        side = along_x * (y - y0) - along_y * (x - x0)  # positive: right of the edge as it runs, y down
        if along_y != 0:
            odd ^= ((y < y0) != (y < y1)) & ((side > 0) if along_y > 0 else (side <= 0))
        on_line = np.flatnonzero(side == 0)
        along = along_x * (x[on_line] - x0) + along_y * (y[on_line] - y0)
        on_border[on_line] |= (along >= 0) & (along <= along_x**2 + along_y**2)
    return odd | on_border


def polygon_mask(polygon_px: Array, width: int, height: int) -> Mask:
    """(height, width) mask of the pixels inside a polygon: for many points, looked up at whole pixels."""
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(np.asarray(polygon_px)).astype(np.int32)], 1)
    return mask.astype(bool)


def _oriented(direction: Array) -> Array:
    """Unit vector along the crack such that the normal (its turn by -90 degrees) points to the right, or down for a
    crack that is more level than upright: 'left' is then the side that a reader calls left (or upper)."""
    unit = np.asarray(direction, float) / np.linalg.norm(direction)
    normal = np.array([unit[1], -unit[0]])
    main = normal[0] if abs(normal[0]) >= abs(normal[1]) else normal[1]
    return -unit if main < 0 else unit
