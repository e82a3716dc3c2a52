"""What is known exactly about a simulated flight: truth.csv and the regions.yaml of its first image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..errors import RegionsError
from .flight import Flight

Array = NDArray[np.float64]

HEADER = (
    "stamp_ns,opening_mm,sliding_mm,out_of_plane_mm,"
    "panel_x_mm,panel_y_mm,panel_z_mm,panel_qx,panel_qy,panel_qz,panel_qw"
)
MARGIN_PX = 24  # of a region from the edges of a plate: half of a large subset and the camera's sway


def save_truth(flight: Flight, start_ns: int, exposed_ns: NDArray[np.int64], path: Path) -> None:
    """truth.csv: one row an image; the crack in mm, then T_camera_panel (translation in mm, quaternion)."""
    lines = [HEADER]
    for exposed in exposed_ns:
        crack, pose = flight.crack(exposed * 1e-9), flight.pose(exposed * 1e-9)
        metres = [crack.opening_m, crack.sliding_m, crack.out_of_plane_m, *pose.t]
        quaternion = Rotation.from_matrix(pose.R).as_quat(canonical=True)
        numbers = [f"{1e3 * value:.9f}" for value in metres] + [f"{value:.12f}" for value in quaternion]
        lines.append(",".join([str(start_ns + int(exposed)), *numbers]))
    path.write_text("\n".join(lines) + "\n")


def project(flight: Flight, points_m: Array, time_s: float) -> Array:
    """Points (N, 3) of the unmoved panel [m] -> pixels (N, 2) of the raw image at a time."""
    pose, camera = flight.pose(time_s), flight.calibration.camera
    return camera.distort(camera.project(np.asarray(points_m, float) @ pose.R.T + pose.t))


def scene_regions(flight: Flight, time_s: float) -> dict[str, Any]:
    """The content of regions.yaml in pixels of the image at a time (docs/files.md).

    Raises:
        RegionsError: the panel's regions do not lie within that image.
    """
    panel, camera = flight.scene.settings, flight.calibration.camera
    footprint_m = flight.pose(time_s).t[2] / camera.fx
    margin_m = MARGIN_PX * footprint_m
    x, y = panel.width_m / 2 - margin_m, panel.height_m / 2 - margin_m
    normal, tangent = flight.scene.normal, flight.scene.tangent
    beside = -(panel.gap_m / 2 + margin_m) * normal
    along = [(height - beside[1]) / tangent[1] for height in (-y, y)]
    top, bottom = (beside + length * tangent for length in along)
    crack = project(flight, np.array([np.zeros(3), -0.02 * tangent, 0.02 * tangent]), time_s)
    direction = (crack[2] - crack[1]) / np.linalg.norm(crack[2] - crack[1])
    regions: dict[str, Any] = {
        "panel": project(flight, np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]), time_s),
        "fixed": [project(flight, np.array([[-x, -y, 0], top, bottom, [-x, y, 0]]), time_s)],
        "x_axis": project(flight, np.array([[-x, 0, 0], [x, 0, 0]]), time_s),
    }
    corners = np.concatenate([regions["panel"], *regions["fixed"]])
    last = [camera.width - 1, camera.height - 1]
    if not np.all((corners >= 0) & (corners <= last)):
        raise RegionsError(
            f"the panel of {panel.width_m} x {panel.height_m} m does not fit the first image of "
            f"{camera.width} x {camera.height} pixels: make it smaller, or the distance larger"
        )
    return {
        "panel": _rounded(regions["panel"]),
        "fixed": [_rounded(polygon) for polygon in regions["fixed"]],
        "x_axis": _rounded(regions["x_axis"]),
        "crack": {
            "point": _rounded(crack[0]),
            "direction": _rounded(direction, 6),
            "size": [round(camera.width / 8), round(camera.height / 3)],
            "gap": round(MARGIN_PX + panel.gap_m / 2 / footprint_m),
        },
    }


def save_regions(flight: Flight, time_s: float, path: Path) -> None:
    """Write regions.yaml for the image at a time."""
    text = "# Regions in pixels of the raw reference image, the first of the flight (docs/files.md).\n"
    content = scene_regions(flight, time_s)
    path.write_text(text + yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _rounded(values: Array, digits: int = 2) -> Any:
    return np.round(values, digits).tolist()
