"""Whether the boards suffice: in number, where they are in the images and how they are tilted; and what is missing."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .alone import calibrate_alone
from .board import Board
from .detection import Found
from .estimate import Estimate
from .model import Model
from .settings import CalibratingSettings
from .views import WORDS, Gathering

Array = NDArray[np.float64]

QUARTERS = {"upper left": (0, 0), "upper right": (0, 1), "lower left": (1, 0), "lower right": (1, 1)}
RASTER = (60, 80)  # rows and columns in which coverage is counted
EDGES = {"vertical": ("left", "right"), "horizontal": ("upper", "lower")}


def coverage(boards: Sequence[Found], width: int, height: int) -> NDArray[np.int64]:
    """How many boards cover each cell of an image, (rows, cols) of RASTER."""
    scale = np.array(RASTER[::-1]) / np.array([width, height])
    count = np.zeros(RASTER, np.int64)
    for found in boards:
        hull = cv2.convexHull(((found.corners_px + 0.5) * scale - 0.5).astype(np.float32))
        mask = np.zeros(RASTER, np.uint8)
        cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
        count += mask
    return count


def tilts(poses: Sequence[tuple[Array, Array]]) -> Array:
    """Angles (N, 2) [rad] of boards from facing the sensor squarely: about the image's vertical axis, positive where
    the right edge is nearer, and about its horizontal axis, positive where the lower edge is."""
    normals = np.array([R[:, 2] for R, _ in poses])
    return np.arctan2(normals[:, :2], normals[:, 2:])


def missing(gathering: Gathering, board: Board, models: dict[str, Model], settings: CalibratingSettings) -> list[str]:
    """What must be added before anything is estimated, in sentences; empty if the boards suffice."""
    wants: list[str] = []
    for sensor, model in models.items():
        boards = [view.of(sensor) for view in gathering.views if view.of(sensor)]
        if len(boards) < settings.least_boards:
            wants.append(
                f"{WORDS[sensor]}: {len(boards)} usable boards in {gathering.seen[sensor]} images, at least "
                f"{settings.least_boards} different ones are needed"
            )
        if len(boards) >= 3:
            wants += _uncovered(sensor, boards, model, settings)
            wants += _untilted(sensor, tilts(calibrate_alone(boards, board, model)[1]), settings.least_tilt_rad)
    if "tof" in models and gathering.count("camera", "tof") < settings.least_pairs:
        wants.append(
            f"both sensors: {gathering.count('camera', 'tof')} boards are seen by both at once, at least "
            f"{settings.least_pairs} are needed"
        )
    return wants


def too_uncertain(estimate: Estimate, settings: CalibratingSettings) -> list[str]:
    """Focal lengths that the boards do not fix, in sentences."""
    return [
        f"{name} is only known to {100 * sigma / value:.1f} % (at most {100 * settings.worst_focal:g} %): add boards "
        "that are tilted more"
        for name, value, sigma in zip(estimate.names, estimate.values, estimate.sigmas, strict=True)
        if name.endswith((".fx", ".fy")) and sigma > settings.worst_focal * value
    ]


def _uncovered(sensor: str, boards: Sequence[Found], model: Model, settings: CalibratingSettings) -> list[str]:
    covered = coverage(boards, model.width, model.height) > 0
    least = settings.covered if model.distortion else settings.covered_undistorted
    wants, half = [], np.array(RASTER) // 2
    for name, (down, right) in QUARTERS.items():
        part = covered[down * half[0] :, right * half[1] :][: half[0], : half[1]].mean()
        if part == 0:
            wants.append(f"{WORDS[sensor]}: no board in the {name} quarter of the image")
        elif part < least:
            wants.append(
                f"{WORDS[sensor]}: boards cover {100 * part:.0f} % of the {name} quarter of the image, at least "
                f"{100 * least:g} % are needed"
            )
    return wants


def _untilted(sensor: str, angles: Array, least_rad: float) -> list[str]:
    wants, degrees = [], f"{np.degrees(least_rad):.0f} degrees or more"
    for axis, angle in zip(EDGES, angles.T, strict=True):
        tilted = (np.any(angle < -least_rad), np.any(angle > least_rad))
        if all(tilted):
            continue
        how = f"tilt it about its {axis} axis by {degrees}, to both sides"
        if any(tilted):
            always, never = EDGES[axis] if tilted[0] else EDGES[axis][::-1]
            how = f"tilt it about its {axis} axis the other way, {never} edge nearer, by {degrees}"
        if np.ptp(angle) < least_rad:
            alike = "all boards are tilted the same way"
        elif any(tilted):
            alike = f"the board is seen from one side only, its {always} edge always nearer"
        else:
            alike = "the boards are hardly tilted"
        wants.append(f"{WORDS[sensor]}: {alike}; {how}")
    return wants
