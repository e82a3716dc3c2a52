"""Where the regions lie in a later image."""

from __future__ import annotations

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
    outlines = {"panel": [regions.panel], "fixed": [*regions.fixed], "fixed_holes": [*regions.fixed_holes]}
    if regions.crack is not None:
        crack = regions.crack
        along = (np.concatenate([crack.left, crack.right]) - crack.point) @ crack.direction
        line = crack.point + np.outer((along.min(), along.max()), crack.direction)
        outlines |= {"left": [crack.left], "right": [crack.right], "crack": [line]}
    carried = {}
    for name, polygons in outlines.items():
        moved = [camera.distort(apply_homography(homography, camera.undistort(polygon))) for polygon in polygons]
        carried[name] = [polygon for polygon in moved if np.isfinite(polygon).all()]
    return carried
