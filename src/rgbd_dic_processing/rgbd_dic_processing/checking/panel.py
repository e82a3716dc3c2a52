"""Checks of what the cameras see of the panel, as if the flight began with these frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Calibration, pixel_rays
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.geometry import Plane
from ..core.layout import SubsetLayout
from ..core.plane import PanelPlane, cloud_of_depth, fit_plane
from ..core.preview import POOR_PX, preview
from ..core.regions import Regions, polygon_mask
from ..core.regions_file import load_regions
from ..core.settings import ProcessingSettings
from .finding import Finding, Level, graded, not_checked, passed

REDRAW = "draw the regions on an image from where the flight begins (rgbd-dic regions, or the live page)"
FLAT_M = 0.01  # residual of the ToF points that a flat panel leaves at most
SHORT_RANGE_M = 1.5  # of a Blaze


def regions_file(
    path: Path, calibration: Calibration, settings: ProcessingSettings
) -> tuple[Finding, Regions | None, int]:
    """Whether regions.yaml fits the images, and how many subsets it has."""
    name = "regions"
    try:
        regions = load_regions(path)
        subsets = len(SubsetLayout(calibration.camera, regions, settings.correlation))
    except RgbdDicError as error:
        return Finding(name, Level.FAIL, str(error), REDRAW), None, 0
    if regions.crack is None:
        return Finding(name, Level.FAIL, f"{path}: no entry 'crack', so no opening", REDRAW), regions, subsets
    return passed(name, f"{subsets} subsets"), regions, subsets


def pattern(
    image: NDArray[np.uint8],
    calibration: Calibration,
    regions: Regions,
    settings: ProcessingSettings,
    noise: float,
    footprint_m: float = np.nan,
) -> Finding:
    """Whether the pattern in the regions is sharp and rich enough: by the uncertainty that each subset would have.

    Args:
        noise: of a pixel [grey levels].
        footprint_m: of a pixel on the panel, if it is known [m].
    """
    name = "focus and texture"
    seen = preview(image, calibration.camera, regions, settings, noise)
    if seen.refusals:
        return Finding(name, Level.FAIL, "; ".join(seen.refusals), f"focus, light, speckle? {REDRAW}")
    members = seen.fixed | seen.left | seen.right
    sigma_px = float(np.nanmedian(seen.sigma_px[members].max(axis=1)))
    opening = "" if np.isnan(footprint_m) else f"; one opening to {seen.u_opening_px * footprint_m * 1e3:.4f} mm"
    text = f"subsets to {sigma_px:.3f} px (median){opening}"
    if seen.warnings:
        return Finding(name, Level.WARN, f"{text}; {'; '.join(seen.warnings)}", "focus, light, speckle, regions")
    return graded(name, text, "focus, light, speckle", sigma_px <= POOR_PX, sigma_px <= 2 * POOR_PX)


def panel_pixels(image: NDArray[np.uint8], regions: Regions | None) -> NDArray[np.uint8]:
    """The pixels of the panel (M,); all if it is not drawn."""
    if regions is None:
        return image.ravel()
    return image[polygon_mask(regions.panel, *image.shape[::-1])]


def depth(
    depth_m: NDArray[np.float32],
    calibration: Calibration,
    regions: Regions,
    settings: ProcessingSettings,
    tof: TofSettings,
) -> tuple[list[Finding], Plane | None]:
    """Whether the ToF camera sees the panel as a plane: enough pixels, a small residual, a distance in range."""
    names = "depth of the panel", "plane", "distance"
    planes = PanelPlane(calibration, regions, settings.plane)
    try:
        points, _ = planes.select(cloud_of_depth(depth_m, calibration.tof), np.eye(3))
        if len(points) < settings.plane.min_points:
            text = f"{len(points)} ToF points on the panel, at least {settings.plane.min_points} needed"
            remedy = f"distance, depth_min_m, depth_max_m, confidence_threshold, T_camera_tof? {REDRAW}"
            return [Finding(names[0], Level.FAIL, text, remedy)], None
        plane, inliers, rms_m = fit_plane(points, settings.plane)
    except RgbdDicError as error:
        return [Finding(names[1], Level.FAIL, str(error), f"something before the panel, or not flat? {REDRAW}")], None
    there = len(points) / max(_expected(planes, plane, calibration), 1)
    distance_m = float(np.median(points[:, 2]))
    flat = f"residual {rms_m * 1e3:.1f} mm RMS, {inliers.mean():.0%} of {len(points)} points on it"
    return [
        graded(
            names[0],
            f"{min(there, 1):.0%} of the ToF pixels on the panel have depth",
            "black, shiny or too far? tof.exposure_s, confidence_threshold, depth limits",
            there >= 0.9,
            there >= 0.5,
        ),
        graded(names[1], flat, "something before the panel, sunlight, reflections?", rms_m <= FLAT_M, bearable=True),
        _distance(names[2], distance_m, tof),
    ], plane


def _expected(planes: PanelPlane, plane: Plane, calibration: Calibration) -> int:
    """How many ToF pixels look at the panel, whether they have depth or not."""
    R, t = calibration.R_camera_tof, calibration.t_camera_tof
    rays = pixel_rays(calibration.tof).reshape(-1, 3)
    points = plane.moved(R.T, -R.T @ t).points(rays)
    return len(planes.select(points[np.isfinite(points).all(axis=1)], np.eye(3))[0])


def _distance(name: str, distance_m: float, tof: TofSettings) -> Finding:
    low, high = tof.depth_min_m, tof.depth_max_m if tof.long_range else min(tof.depth_max_m, SHORT_RANGE_M)
    text = f"{distance_m:.2f} m, depth from {low:g} to {high:g} m"
    remedy = "fly so that the panel stays well within, or set depth_min_m, depth_max_m, long_range"
    good = 1.1 * low <= distance_m <= 0.9 * high
    return graded(name, text, remedy, good, low <= distance_m <= high)


def footprint_m(plane: Plane, calibration: Calibration) -> float:
    """Of a pixel on the panel [m]."""
    return -plane.d / calibration.camera.fx


def not_looked(why: str) -> list[Finding]:
    """The checks of this file where a camera or the regions are missing."""
    return [not_checked(name, why) for name in ("depth of the panel", "plane", "distance")]
