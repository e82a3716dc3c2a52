"""Where the regions lie in a later image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .geometry import apply_homography
from .regions import Regions

Array = NDArray[np.float64]


def carried_regions(regions: Regions, camera: Camera, homography: Array) -> dict[str, list[Array]]:
    """The outlines of the regions in the raw image that a homography leads to.

    Args:
        homography: (3, 3), image that the regions are drawn on -> image, ideal pixels; NaN if the panel was not found.

    Returns:
        "panel", "fixed", "fixed_holes", "left", "right" and "crack" -> polygons (M, 2) [px]; "crack" is the line along
        the zones, of two points. What would lie behind the camera is left out.
    """
    carried = carried_ideal(regions, camera, homography)
    return {name: [camera.distort(polygon) for polygon in polygons] for name, polygons in carried.items()}


def carried_ideal(regions: Regions, camera: Camera, homography: Array) -> dict[str, list[Array]]:
    """As `carried_regions`, in ideal pixels."""
    outlines = {"panel": [regions.panel], "fixed": [*regions.fixed], "fixed_holes": [*regions.fixed_holes]}
    if regions.crack is not None:
        crack = regions.crack
        along = (np.concatenate([crack.left, crack.right]) - crack.point) @ crack.direction
        line = crack.point + np.outer((along.min(), along.max()), crack.direction)
        outlines |= {"left": [crack.left], "right": [crack.right], "crack": [line]}
    carried = {}
    for name, polygons in outlines.items():
        moved = [apply_homography(homography, camera.undistort(polygon)) for polygon in polygons]
        carried[name] = [polygon for polygon in moved if np.isfinite(polygon).all()]
    return carried


def carried_entries(entries: Mapping[str, Any], camera: Camera, homography: Array) -> dict[str, Any]:
    """The entries of regions.yaml, to be drawn on the raw image that a homography leads to: a start for the user.

    Polygons and the axis follow exactly, as far as they lie in the image. Zones stay rectangles: their place and the
    crack's direction follow, and their sizes by the scale there.

    Args:
        homography: as of `carried_regions`, finite.
    """
    last = np.array([camera.width, camera.height]) - 1

    def move(points: Any) -> Array:
        return camera.distort(apply_homography(homography, camera.undistort(np.array(points, float).reshape(-1, 2))))

    def polygon(points: Any) -> list[list[float]]:
        return np.round(np.clip(move(points), 0, last), 1).tolist()

    carried: dict[str, Any] = {name: polygon(entries[name]) for name in ("panel", "x_axis") if entries.get(name)}
    for name in ("fixed", "fixed_holes"):
        if entries.get(name):
            carried[name] = [polygon(points) for points in entries[name]]
    if crack := entries.get("crack"):
        carried["crack"] = _carried_crack(crack, move, last)
    return carried


def _carried_crack(crack: Mapping[str, Any], move: Any, last: Array) -> dict[str, Any]:
    def turned(at: Array, direction: Any) -> list[float]:
        along = np.array(direction, float) / np.linalg.norm(direction)
        start, end = move([at - along / 2, at + along / 2])
        return np.round((end - start) / np.linalg.norm(end - start), 4).tolist()

    def scale(at: Array) -> float:
        left, right, up, down = move(at + 0.5 * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)]))
        return float(np.sqrt(np.linalg.norm(right - left) * np.linalg.norm(down - up)))

    if "point" in crack:
        point = np.array(crack["point"], float)
        size = [round(scale(point) * float(length), 1) for length in (*crack["size"], crack.get("gap", 0))]
        place = np.round(np.clip(move(point)[0], 0, last), 1).tolist()
        return {"point": place, "direction": turned(point, crack["direction"]), "size": size[:2], "gap": size[2]}
    boxes = {side: np.array(crack[side], float).reshape(2, 2) for side in ("left", "right")}
    carried = {}
    for side, box in boxes.items():
        middle, half = box.mean(axis=0), np.abs(box[1] - box[0]) / 2 * scale(box.mean(axis=0))
        moved = np.clip([move(middle)[0] - half, move(middle)[0] + half], 0, last)
        carried[side] = np.round(moved, 1).ravel().tolist()
    if "direction" in crack:
        carried["direction"] = turned(
            (boxes["left"].mean(axis=0) + boxes["right"].mean(axis=0)) / 2, crack["direction"]
        )
    return carried
