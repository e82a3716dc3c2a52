"""The regions that a user of the laboratory would draw on the first image, and the points of the measuring zones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RegionsError

if TYPE_CHECKING:
    from .laboratory import Laboratory

Array = NDArray[np.float64]

BORDER_M = 0.03  # of the panel that is left out, so that subsets stay in view while the hand sways
BESIDE_PX = 20  # from the crack to the zones: half of a subset and the crack's own width
ZONE = (1 / 36, 1 / 6)  # size of a zone, across and along the crack, as parts of the image's width and height
LATTICE = 24  # points along each side of a zone


def laboratory_regions(laboratory: Laboratory) -> dict[str, Any]:
    """The content of regions.yaml in pixels of the first image (docs/files.md).

    All of the panel is the region for the motion, as the thesis chose (4.3.2.3); its left half where that is rigid.

    Raises:
        RegionsError: the panel's regions do not lie within that image.
    """
    s, camera, now = laboratory.settings, laboratory.calibration.camera, laboratory.reference_s
    x, y = s.panel.width_m / 2 - BORDER_M, s.panel.height_m / 2 - BORDER_M
    beside = 3 * s.panel.gap_m + BESIDE_PX * s.motion.distance_m / camera.fx

    def seen(*points: tuple[float, float], side: int | None = None) -> Array:
        return laboratory.project(*np.array(points).T, now, side)

    panel = seen((-x, -y), (x, -y), (x, y), (-x, y))
    if not np.all((panel >= 0) & (panel <= [camera.width - 1, camera.height - 1])):
        raise RegionsError(
            f"the panel of {s.panel.width_m:g} x {s.panel.height_m:g} m does not fit the first image of "
            f"{camera.width} x {camera.height} pixels: make it smaller, or the distance larger"
        )
    faces = [seen((0, -0.02), (0, 0), (0, 0.02), side=side) for side in (-1, 1)]
    above, point, below = np.mean(faces, axis=0)
    direction = (below - above) / np.linalg.norm(below - above)
    regions: dict[str, Any] = {"panel": _rounded(panel)}
    if s.deformation.field == "rigid_half":
        regions["fixed"] = [_rounded(seen((-x, -y), (-beside, -y), (-beside, y), (-x, y)))]
    return regions | {
        "x_axis": _rounded(seen((-x, 0), (x, 0))),
        "crack": {
            "point": _rounded(point),
            "direction": _rounded(direction, 6),
            "size": [round(camera.width * ZONE[0]), round(camera.height * ZONE[1])],
            "gap": BESIDE_PX,
        },
    }


def zone_pixels(crack: dict[str, Any]) -> tuple[Array, Array]:
    """Evenly spread pixels (N, 2) of the left and of the right zone of the entry `crack` of regions.yaml."""
    tangent = np.array(crack["direction"])
    normal = np.array([tangent[1], -tangent[0]])
    across, along = crack["size"]
    even = (np.arange(LATTICE) + 0.5) / LATTICE
    out, down = np.meshgrid(crack["gap"] + across * even, along * (even - 0.5))
    out, down = out.reshape(-1, 1), down.reshape(-1, 1)
    left, right = (np.array(crack["point"]) + side * out * normal + down * tangent for side in (-1, 1))
    return left, right


def _rounded(values: Array, digits: int = 2) -> Any:
    return np.round(values, digits).tolist()
