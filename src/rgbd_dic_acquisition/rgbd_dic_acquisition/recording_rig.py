"""Which cameras an old recording was made with: what is given, and else what is assumed and said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .calibration import Calibration, Camera
from .errors import CalibrationError

PLANE_PIXELS = 160  # longer side of the depth image of a constant plane
METRES_A_PIXEL = 1e-3  # where neither focal length nor distance is known: one pixel reads as one millimetre


def recording_rig(
    image_shape: tuple[int, int],
    calibration: Calibration | None,
    focal_px: float | None,
    notes: list[str],
) -> Calibration:
    """The calibration, or a pinhole without distortion; what was assumed is added to `notes`.

    Raises:
        CalibrationError: the calibration is of another image size, or the focal length is not above 0.
    """
    rows, cols = image_shape
    if calibration is None:
        focal = float(cols if focal_px is None else focal_px)
        centre = (cols - 1) / 2, (rows - 1) / 2
        given = "as given" if focal_px is not None else "the image's width, a guess"
        notes.append(
            f"no calibration: a pinhole without distortion, focal length {focal:g} px ({given}), principal "
            "point in the middle; lengths are only as good as that"
        )
        return Calibration(Camera(cols, rows, focal, focal, *centre))
    camera = calibration.camera
    if (camera.width, camera.height) != (cols, rows):
        raise CalibrationError(
            f"the calibration is of images of {camera.width} x {camera.height} pixels, the recording has "
            f"{cols} x {rows}: give the calibration of this camera at this size"
        )
    return calibration


def with_constant_plane(rig: Calibration, distance_m: float | None, notes: list[str]) -> tuple[Calibration, float]:
    """A rig whose ToF sensor is the camera itself with fewer pixels, and the distance of its plane.

    Raises:
        CalibrationError: the distance is not within 0.01 and 1000 m.
    """
    camera = rig.camera
    if distance_m is None:
        distance_m = METRES_A_PIXEL * (camera.fx + camera.fy) / 2
        notes.append(
            f"no depth and no distance: a plane squarely in front at {distance_m:.6g} m, so that 1 mm in the "
            "results is 1 pixel; the scale is unknown"
        )
    else:
        if not 0.01 <= distance_m <= 1000.0:
            raise CalibrationError(f"distance of the plane {distance_m!r} m: must be between 0.01 and 1000 m")
        notes.append(f"no depth: a constant plane squarely in front of the camera at {distance_m:.6g} m")
    scale = min(1.0, PLANE_PIXELS / max(camera.width, camera.height))
    width, height = (max(8, round(size * scale)) for size in (camera.width, camera.height))
    tof = replace(camera.scaled_to(width, height), k1=0.0, k2=0.0)
    return Calibration(camera, tof, np.eye(3), np.zeros(3)), distance_m


def with_depth_images(rig: Calibration, depth_shape: tuple[int, int], notes: list[str]) -> Calibration:
    """The rig for depth images of this shape; without a ToF sensor they must be aligned with the images.

    Raises:
        CalibrationError: the calibration's ToF sensor is of another size, or is missing where it is needed.
    """
    rows, cols = depth_shape
    camera, tof = rig.camera, rig.tof
    if tof is None and (camera.width, camera.height) == (cols, rows):
        notes.append("no ToF sensor in the calibration: depth is taken as aligned with the images, pixel by pixel")
        return Calibration(camera, camera, np.eye(3), np.zeros(3))
    if tof is None:
        raise CalibrationError(
            f"depth images of {cols} x {rows} pixels need a calibration with 'tof' and 'T_camera_tof', "
            f"because they are not aligned with the images of {camera.width} x {camera.height} pixels"
        )
    if (tof.width, tof.height) != (cols, rows):
        raise CalibrationError(
            f"the calibration's ToF sensor has {tof.width} x {tof.height} pixels, the depth files have "
            f"{cols} x {rows}: give the calibration of this sensor at this size"
        )
    return rig


def with_clouds(rig: Calibration, notes: list[str]) -> Calibration:
    """The rig for clouds; without extrinsics they must be in the camera's frame."""
    if rig.tof is None:
        notes.append("no ToF sensor in the calibration: clouds are taken as points in the camera's optical frame")
    return rig
