"""The panel in the laboratory as a surface: where its material is, and which material a pixel sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..calibration import Camera
from ..settings import Settings, setting
from .laboratory_fields import Deformation
from .motion import Pose

Array = NDArray[np.float64]

NODES = 16  # Chebyshev nodes along each side of a window; of the maps, which are smooth, 12 leave 1e-14 m
ITERATIONS = 30
CONVERGED_M = 1e-13
BORDER_POINTS = 9  # of each side of a half, projected to find its window
LEFT, RIGHT = -1, 1


@dataclass(frozen=True)
class LaboratoryPanelSettings(Settings):
    """The panel, its crack, and the wall behind it."""

    width_m: float = setting(1.2, unit="m", low=0.05, high=20.0, doc="side along the panel's x axis (thesis 4.1.1)")
    height_m: float = setting(0.6, unit="m", low=0.05, high=20.0, doc="side along the panel's y axis")
    gap_m: float = setting(0.0003, unit="m", low=0.0, high=0.1, doc="width of the crack without load")
    gap_grey: float = setting(10.0, unit="grey levels", low=0.0, high=255.0, doc="grey level inside the crack")
    wall_offset_m: float = setting(0.6, unit="m", low=0.01, high=100.0, doc="from the panel to the wall")
    wall_grey: float = setting(60.0, unit="grey levels", low=0.0, high=255.0, doc="grey level of the wall")


@dataclass(frozen=True)
class Window:
    """What the pixels (rows, cols) of a part of an image see of one half, taken as going on beyond its borders.

    rows, cols: where the window is in the image. x_m, y_m: material coordinates [m]; depth_m: along the optical axis.
    pixel_x_m, pixel_y_m: length on the panel of a pixel, across its edges, in the middle of the window [m].
    """

    rows: slice
    cols: slice
    x_m: Array
    y_m: Array
    depth_m: Array
    pixel_x_m: float
    pixel_y_m: float


class BendingPanel:
    """Two deformed halves. Material (x, y) of the unloaded panel is at (x + dx, y + dy, shape + dz)."""

    def __init__(self, settings: LaboratoryPanelSettings, deformation: Deformation) -> None:
        self.settings, self.deformation = settings, deformation

    def points(self, x_m: Array, y_m: Array, stroke_m: float, side: Array | int | None = None) -> Array:
        """(..., 3) position of material in the panel frame [m]."""
        moved = self.deformation.displacement(x_m, y_m, stroke_m, side)
        return moved + np.stack(np.broadcast_arrays(x_m, y_m, self.deformation.shape(x_m, y_m)), axis=-1)

    def project(
        self, camera: Camera, pose: Pose, x_m: Array, y_m: Array, stroke_m: float, side: Array | int | None = None
    ) -> Array:
        """Raw pixels (..., 2) of material."""
        seen = self.points(np.asarray(x_m, float), np.asarray(y_m, float), stroke_m, side) @ pose.R.T + pose.t
        return camera.distort(camera.project(seen))

    def material(self, rays: Array, pose: Pose, stroke_m: float, side: Array | int) -> tuple[Array, Array, Array]:
        """x, y of the material of one half, and depth [m], that rays (..., 3), z = 1, end on.

        The inverse of `points`: fixed point X = (where the ray meets z = shape(X) + dz(X)) - (dx, dy)(X). Each step
        is better by the strains and slopes, below a hundredth, so it ends at the last bits.
        """
        centre, towards = -pose.R.T @ pose.t, rays @ pose.R
        slope_x, slope_y = towards[..., 0] / towards[..., 2], towards[..., 1] / towards[..., 2]
        x, y = centre[0] - centre[2] * slope_x, centre[1] - centre[2] * slope_y
        for _ in range(ITERATIONS):
            dx, dy, dz = np.moveaxis(self.deformation.displacement(x, y, stroke_m, side), -1, 0)
            z = self.deformation.shape(x, y) + dz
            before = x, y
            x = centre[0] + (z - centre[2]) * slope_x - dx
            y = centre[1] + (z - centre[2]) * slope_y - dy
            if max(np.max(np.abs(x - before[0])), np.max(np.abs(y - before[1]))) < CONVERGED_M:
                break
        return x, y, (z - centre[2]) / towards[..., 2]

    def window(self, camera: Camera, pose: Pose, stroke_m: float, side: int) -> Window | None:
        """The part of an image that holds one half and the open crack; None if that is not in view.

        The material of every pixel is interpolated between Chebyshev nodes, where it is exact.
        """
        box = self._box(camera, pose, stroke_m, side)
        if box is None:
            return None
        first, last = box
        across, down = _Nodes(first[0], last[0]), _Nodes(first[1], last[1])
        values = self.material(_rays(camera, across, down), pose, stroke_m, side)
        x, y, depth = (_spread(value, down, across) for value in values)
        rows, cols = slice(first[1], last[1] + 1), slice(first[0], last[0] + 1)
        return Window(rows, cols, x, y, depth, _step(x), _step(y))

    def in_front(self, camera: Camera, pose: Pose, distance_m: float) -> Window:
        """What all pixels see of the plane z = -distance_m, in x and y of the panel frame."""
        across, down = _Nodes(0, camera.width - 1), _Nodes(0, camera.height - 1)
        centre, towards = -pose.R.T @ pose.t, _rays(camera, across, down) @ pose.R
        depth = (-distance_m - centre[2]) / towards[..., 2]
        values = centre[0] + depth * towards[..., 0], centre[1] + depth * towards[..., 1], depth
        x, y, depth = (_spread(value, down, across) for value in values)
        return Window(slice(0, camera.height), slice(0, camera.width), x, y, depth, _step(x), _step(y))

    def coverage(self, window: Window, side: int) -> tuple[Array, Array]:
        """Parts of each pixel, 0 to 1: that one half covers, and that lies within the panel's outer edges."""
        s, beside = self.settings, side * window.x_m
        body = ramp((s.width_m / 2 - beside) / window.pixel_x_m)
        body *= ramp((s.height_m / 2 - np.abs(window.y_m)) / window.pixel_y_m)
        return body * ramp((beside - s.gap_m / 2) / window.pixel_x_m), body

    def _box(self, camera: Camera, pose: Pose, stroke_m: float, side: int) -> tuple[Array, Array] | None:
        """First and last pixel (x, y) of a half's window."""
        half = np.linspace(-0.5, 0.5, BORDER_POINTS) * self.settings.height_m
        along = np.linspace(0.0, side * self.settings.width_m / 2, BORDER_POINTS)
        edges = [
            (np.zeros(BORDER_POINTS), half, side),
            (np.zeros(BORDER_POINTS), half, -side),
            (along, np.full(BORDER_POINTS, half[0]), side),
            (along, np.full(BORDER_POINTS, half[-1]), side),
            (np.full(BORDER_POINTS, along[-1]), half, side),
        ]
        border = np.concatenate([self.project(camera, pose, x, y, stroke_m, at) for x, y, at in edges])
        limit = np.array([camera.width - 1, camera.height - 1])
        first = np.maximum(np.floor(border.min(axis=0)).astype(int) - 2, 0)
        last = np.minimum(np.ceil(border.max(axis=0)).astype(int) + 2, limit)
        return (first, last) if np.all(last - first >= 2) else None


class _Nodes:
    """Chebyshev nodes `at` between two pixels, and the matrix `rise` (pixels, nodes) that interpolates them."""

    def __init__(self, first: int, last: int) -> None:
        node = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        self.at = 0.5 * (first + last) + 0.5 * (last - first) * node
        fit = chebyshev.chebvander(node, NODES - 1).T * (2.0 / NODES)
        fit[0] *= 0.5
        self.rise = chebyshev.chebvander(np.linspace(-1.0, 1.0, last - first + 1), NODES - 1) @ fit


def _rays(camera: Camera, across: _Nodes, down: _Nodes) -> Array:
    """Rays (NODES, NODES, 3), z = 1, at the nodes."""
    pixels = np.stack(np.meshgrid(across.at, down.at), axis=-1)
    return camera.rays(camera.undistort(pixels.reshape(-1, 2))).reshape(NODES, NODES, 3)


def _spread(values: Array, down: _Nodes, across: _Nodes) -> Array:
    """From the nodes to all pixels; by einsum, as threads of a BLAS get in the way of each other here."""
    return np.einsum("ik,jk->ij", np.einsum("ik,kj->ij", down.rise, values), across.rise)


def _step(values: Array) -> float:
    """Length of the gradient in the middle, for each pixel."""
    row, col = values.shape[0] // 2, values.shape[1] // 2
    return float(np.hypot(values[row, col] - values[row - 1, col], values[row, col] - values[row, col - 1]))


def ramp(distance_px: Array) -> Array:
    """Part of a pixel on the positive side of a straight edge, from the distance of its middle [px]."""
    return np.clip(distance_px + 0.5, 0.0, 1.0)
