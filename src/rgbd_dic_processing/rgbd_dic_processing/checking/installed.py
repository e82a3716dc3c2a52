"""Checks of what is installed, and of the calibration file."""

from __future__ import annotations

import importlib
import math
from pathlib import Path

import numpy as np
from rgbd_dic_acquisition.calibration import Calibration, Camera, load_calibration
from rgbd_dic_acquisition.drivers.aravis_library import aravis
from rgbd_dic_acquisition.drivers.tof_device import LIBRARIES, device_class
from rgbd_dic_acquisition.errors import RgbdDicError

from .finding import Finding, Level, graded, passed

SIMULATED = "simulated"


def camera_driver(source: str = "aravis") -> Finding:
    """Whether the library of the camera can be loaded."""
    name = "camera driver"
    if source == SIMULATED:
        return Finding(name, Level.WARN, "the camera is simulated", "camera_node: source: aravis in payload.yaml")
    try:
        aravis()
    except RgbdDicError as error:
        return Finding(name, Level.FAIL, str(error), "install it as docs/payload.md says")
    return passed(name, "Aravis 0.8")


def tof_driver(source: str) -> Finding:
    """Whether the library of the ToF camera can be loaded."""
    name = "ToF driver"
    if source == SIMULATED:
        return Finding(name, Level.WARN, "the ToF camera is simulated", "tof_node: source: pylon or gentl")
    if source not in LIBRARIES:
        return Finding(name, Level.FAIL, f"source '{source}' is not known", f"choose {' or '.join(LIBRARIES)}")
    try:
        device_class(source)
    except RgbdDicError as error:
        return Finding(name, Level.FAIL, str(error), "make setup-tof")
    return passed(name, f"{source}: {LIBRARIES[source][2]}")


def autopilot_driver() -> Finding:
    """Whether pymavlink can be loaded."""
    try:
        importlib.import_module("rgbd_dic_acquisition.drivers.mavlink")
    except ImportError as error:
        return Finding("MAVLink", Level.FAIL, f"pymavlink is missing ({error})", "pip install pymavlink")
    return passed("MAVLink", "pymavlink")


def calibration_file(path: Path) -> tuple[Finding, Calibration | None]:
    """Whether calibration.yaml can be read, has both sensors, and has numbers that such sensors can have."""
    name = "calibration"
    try:
        calibration = load_calibration(path)
    except RgbdDicError as error:
        return Finding(name, Level.FAIL, str(error), "give the file of this camera with --calibration"), None
    if calibration.tof is None:
        text = f"{path} has no 'tof': planes need its intrinsics and T_camera_tof"
        return Finding(name, Level.FAIL, text, "calibrate the ToF camera too: rgbd-dic calibrate"), calibration
    odd = [f"camera: {text}" for text in _oddities(calibration.camera)]
    odd += [f"tof: {text}" for text in _oddities(calibration.tof)]
    distance_m = float(np.linalg.norm(calibration.t_camera_tof))
    turn = math.degrees(math.acos(np.clip((np.trace(calibration.R_camera_tof) - 1) / 2, -1, 1)))
    if distance_m == 0 or distance_m > 0.5:
        odd.append(f"the sensors are {distance_m * 1e3:.0f} mm apart")
    if turn > 20:
        odd.append(f"they look {turn:.0f} degrees apart")
    camera = calibration.camera
    text = f"{camera.width} x {camera.height} px, {camera.fx:.0f} px; ToF camera {distance_m * 1e3:.0f} mm beside it"
    remedy = "is it this payload's? Else calibrate anew: rgbd-dic calibrate"
    return graded(name, "; ".join(odd) or text, remedy, not odd, bearable=True), calibration


def _oddities(camera: Camera) -> list[str]:
    """What no ordinary camera has."""
    odd = []
    degrees = math.degrees(2 * math.atan(camera.width / 2 / camera.fx))
    if not 5 < degrees < 120:
        odd.append(f"field of view of {degrees:.0f} degrees")
    if abs(camera.fx / camera.fy - 1) > 0.03:
        odd.append(f"focal lengths {camera.fx:.0f} and {camera.fy:.0f} px differ")
    if abs(camera.cx / camera.width - 0.5) > 0.15 or abs(camera.cy / camera.height - 0.5) > 0.15:
        odd.append(f"principal point {camera.cx:.0f}, {camera.cy:.0f} px far from the middle")
    corner = np.array([[0.0, 0.0], [camera.width - 1.0, camera.height - 1.0]])
    away = np.abs(camera.undistort(corner) - corner).max() / camera.width
    if not away < 0.2:  # also NaN: the model folds back inside the image
        odd.append("its distortion does not hold up to the corners")
    return odd
