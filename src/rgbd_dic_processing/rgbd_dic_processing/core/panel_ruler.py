"""Lengths on the panel: pixels of the raw image to metres, once its plane is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .geometry import Plane
from .regions import Regions

Array = NDArray[np.float64]


class PanelRuler:
    """Measures on a plane in the camera frame of the image that the regions are drawn on."""

    def __init__(self, camera: Camera, plane: Plane):
        self._camera, self._plane = camera, plane

    def length_m(self, start_px: Array, end_px: Array) -> float:
        """Distance on the panel between two points (2,) of the raw image [m]; NaN if one is not on the panel."""
        points = self._points(np.stack([start_px, end_px]))
        return float(np.linalg.norm(points[1] - points[0]))

    def pixel_m(self, at_px: Array, direction: Array) -> float:
        """Length of a pixel at a point (2,), along a direction (2,) in the raw image [m]."""
        half = 0.5 * np.asarray(direction, float) / np.linalg.norm(direction)
        return self.length_m(at_px - half, at_px + half)

    def sizes_m(self, regions: Regions) -> dict[str, float]:
        """Name -> length of what a user draws, and the distance of the panel along the optical axis [m].

        Polygons are as wide and as high as the image's rows and columns through the middle of what they reach over.
        """
        middle = (regions.panel.min(axis=0) + regions.panel.max(axis=0)) / 2
        sizes = {
            "distance": float(self._points(middle[None])[0, 2]),
            "pixel": self.pixel_m(middle, np.array([1.0, 0.0])),
        }
        polygons = {"panel": regions.panel}
        for kind, drawn in (("fixed", regions.fixed), ("fixed_holes", regions.fixed_holes)):
            polygons |= {f"{kind}{i}": polygon for i, polygon in enumerate(drawn)}
        for name, polygon in polygons.items():
            (x0, y0), (x1, y1) = low, high = polygon.min(axis=0), polygon.max(axis=0)
            x, y = (low + high) / 2
            sizes[f"{name} width"] = self.length_m(np.array([x0, y]), np.array([x1, y]))
            sizes[f"{name} height"] = self.length_m(np.array([x, y0]), np.array([x, y1]))
        if regions.x_axis is not None:
            sizes["x axis"] = self.length_m(*regions.x_axis)
        if regions.crack is not None:
            crack = regions.crack
            for name, zone in (("left zone", crack.left), ("right zone", crack.right)):
                edges = np.roll(zone, -1, axis=0) - zone
                across = int(np.argmax(np.abs(edges[:2] @ crack.normal)))
                sizes[f"{name} across"] = self.length_m(zone[across], zone[across + 1])
                sizes[f"{name} along"] = self.length_m(zone[1 - across], zone[2 - across])
            sizes["between zone centres"] = self.length_m(crack.left.mean(axis=0), crack.right.mean(axis=0))
            sizes["pixel across the crack"] = self.pixel_m(crack.point, crack.normal)
        return sizes

    def _points(self, raw_px: Array) -> Array:
        return self._plane.points(self._camera.rays(self._camera.undistort(raw_px)))
