"""The scene in front of the sensors: a cracked panel and, behind it, a wall. What a ray sees, exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..settings import Settings, setting
from .motion import CrackState, Pose
from .speckle import FlatPattern, Pattern

Array = NDArray[np.float64]

WALL, PAINTED, GAP = 0, 1, 2  # what a ray ends on


@dataclass(frozen=True)
class PanelSettings(Settings):
    """Two plates with a gap between them, and the wall behind."""

    width_m: float = setting(0.58, unit="m", low=0.01, high=20.0, doc="side along the panel's x axis")
    height_m: float = setting(0.42, unit="m", low=0.01, high=20.0, doc="side along the panel's y axis")
    gap_m: float = setting(0.002, unit="m", low=0.0, high=1.0, doc="width of the crack at opening 0")
    crack_angle_rad: float = setting(
        0.0, unit="rad", low=-1.5, high=1.5, doc="angle of the crack from the panel's y axis, towards -x"
    )
    wall_offset_m: float = setting(0.6, unit="m", low=0.01, high=100.0, doc="from the panel to the wall")
    gap_grey: float = setting(12.0, unit="grey levels", low=0.0, high=255.0, doc="grey level inside the gap")
    wall_grey: float = setting(95.0, unit="grey levels", low=0.0, high=255.0, doc="grey level of the wall")


@dataclass(frozen=True)
class Sight:
    """What rays end on; all arrays have the shape of the rays without their last axis.

    Attributes:
        surface: uint8, WALL, PAINTED or GAP.
        x_m, y_m: material coordinates in the panel frame at the reference [m]; of the left plate's plane where the ray
            ends on neither plate.
        z_m: depth along the optical axis [m].
    """

    surface: NDArray[np.uint8]
    x_m: Array
    y_m: Array
    z_m: Array


class Scene(Protocol):
    """Anything that can be looked at. A panel that bends is another class with these three methods."""

    def look(self, rays: Array, pose: Pose, crack: CrackState) -> Sight:
        """What rays (..., 3), z = 1, of a sensor at `pose` end on."""

    def grey(self, sight: Sight) -> Array:
        """Grey level (0-255, not rounded) of what they end on."""

    def uniform(self, sight: Sight, crack: CrackState, reach_m: Array) -> NDArray[np.bool_] | None:
        """Where all rays up to a distance on the panel [m] see the same, so that one does; None: nowhere."""


class CrackedPanel:
    """Two rigid plates in the plane z = 0 of the panel frame; the left one stays, the right one moves.

    The frame has its origin at the crack's centre, x to the right, y down, z into the wall. The crack runs
    along `tangent` through the origin; `normal` points from the left plate to the right one.
    """

    def __init__(self, settings: PanelSettings, pattern: Pattern) -> None:
        self.settings = settings
        self._pattern = pattern
        angle = settings.crack_angle_rad
        self.normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        self.tangent = np.array([-np.sin(angle), np.cos(angle), 0.0])

    def displacement(self, crack: CrackState) -> Array:
        """Of the right plate since the reference, (3,) in the panel frame [m]."""
        out_of_plane = np.array([0.0, 0.0, crack.out_of_plane_m])
        return crack.opening_m * self.normal + crack.sliding_m * self.tangent + out_of_plane

    def look(self, rays: Array, pose: Pose, crack: CrackState) -> Sight:
        """What rays (..., 3) of a sensor at `pose` end on; by the exact inverse of the projection."""
        shifted = Pose(pose.R, pose.t + pose.R @ self.displacement(crack))
        wall = Pose(pose.R, pose.t + pose.R @ np.array([0.0, 0.0, self.settings.wall_offset_m]))
        half_gap = self.settings.gap_m / 2
        (x_left, y_left, z_left), (x_right, y_right, z_right) = (_hit(rays, at) for at in (pose, shifted))
        across_left = self.normal[0] * x_left + self.normal[1] * y_left
        across_right = self.normal[0] * x_right + self.normal[1] * y_right
        in_panel = self._inside(x_left, y_left)
        on_left = in_panel & (across_left <= -half_gap)
        on_right = self._inside(x_right, y_right) & (across_right >= half_gap)
        on_left &= ~(on_right & (z_right < z_left))
        on_right &= ~on_left
        in_gap = in_panel & ~(on_left | on_right) & (across_left <= half_gap + max(crack.opening_m, 0.0))
        surface = np.full(x_left.shape, WALL, np.uint8)
        surface[on_left | on_right], surface[in_gap] = PAINTED, GAP
        z = np.where(on_right, z_right, np.where(surface == WALL, _hit(rays, wall)[2], z_left))
        return Sight(surface, np.where(on_right, x_right, x_left), np.where(on_right, y_right, y_left), z)

    def grey(self, sight: Sight) -> Array:
        painted = sight.surface == PAINTED
        grey = np.where(sight.surface == GAP, float(self.settings.gap_grey), float(self.settings.wall_grey))
        grey[painted] = self._pattern.grey(sight.x_m[painted], sight.y_m[painted])
        return grey

    def uniform(self, sight: Sight, crack: CrackState, reach_m: Array) -> NDArray[np.bool_] | None:
        """Where all rays up to a distance on the panel [m] see the same: away from every border of its parts."""
        if not isinstance(self._pattern, FlatPattern):
            return None
        s, x, y = self.settings, sight.x_m, sight.y_m
        across = np.abs(self.normal[0] * x + self.normal[1] * y)
        within = np.minimum(s.width_m / 2 - np.abs(x), s.height_m / 2 - np.abs(y))
        moved = float(np.linalg.norm(self.displacement(crack)))
        overlap = max(-crack.opening_m, 0.0)
        inner = (sight.surface == PAINTED) & (within > reach_m) & (across > s.gap_m / 2 + overlap + reach_m)
        alike = (sight.surface == WALL) & (within < -moved - reach_m)
        alike[inner] = self._pattern.uniform(x[inner], y[inner], reach_m[inner])
        return alike

    def _inside(self, x: Array, y: Array) -> NDArray[np.bool_]:
        return (np.abs(x) <= self.settings.width_m / 2) & (np.abs(y) <= self.settings.height_m / 2)


def _hit(rays: Array, pose: Pose) -> tuple[Array, Array, Array]:
    """Where rays (..., 3) meet the plane z = 0 of a pose: plane coordinates x, y and depth z of each [m]."""
    to_plane = np.linalg.inv(np.stack([pose.R[:, 0], pose.R[:, 1], pose.t], axis=1))
    x, y = rays[..., 0], rays[..., 1]  # rays[..., 2] is 1
    depth = 1.0 / (to_plane[2, 0] * x + to_plane[2, 1] * y + to_plane[2, 2])
    return (
        (to_plane[0, 0] * x + to_plane[0, 1] * y + to_plane[0, 2]) * depth,
        (to_plane[1, 0] * x + to_plane[1, 1] * y + to_plane[1, 2]) * depth,
        depth,
    )
