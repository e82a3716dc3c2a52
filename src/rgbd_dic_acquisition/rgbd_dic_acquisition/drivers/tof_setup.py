"""Setting up a ToF camera by its features, and what it says that its numbers mean.

Names and units are those of Basler's Blaze (product documentation: Operating Mode, Fast Mode, ROI (blaze),
Component Selector, Pixel Format (blaze), Processing Measurement Results) and of GenICam's SFNC. What a device
lacks is left as it is and told; what it refuses is an error.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..calibration import Camera
from ..errors import DeviceError
from .tof_components import Coordinates
from .tof_features import Features
from .tof_settings import RANGE_FORMATS, TofSettings

AXES = ("CoordinateA", "CoordinateB", "CoordinateC")
UNITS_M = {"Millimeter": 1e-3, "Meter": 1.0, "Micrometer": 1e-6}
# Not worth a word where they are missing: the device then does what they would make it do.
DISPENSABLE = ("TriggerMode", "AcquisitionMode", "AcquisitionFrameRateEnable", "GenDCStreamingMode")


def set_up(features: Features, settings: TofSettings) -> list[str]:
    """Set up a device that is not streaming; what it could not do, in words.

    Raises:
        SettingsError: the device refuses a setting.
        DeviceError: it does not answer, or has a component in no format that is read.
    """
    depth_mm = (1e3 * settings.depth_min_m, 1e3 * settings.depth_max_m)
    wanted: list[tuple[str, Any]] = [
        ("TriggerMode", "Off"),
        ("AcquisitionMode", "Continuous"),
        ("OperatingMode", "LongRange" if settings.long_range else "ShortRange"),  # moves the limits of those below
        ("FastMode", settings.fast_mode),
        ("DistortionCorrection", True),  # so that a pinhole describes it
        ("GenDCStreamingMode", "On" if settings.gendc else "Off"),
    ]
    if settings.exposure_s > 0:
        wanted.append(("ExposureTime", 1e6 * settings.exposure_s))
    if settings.confidence_threshold >= 0:
        wanted.append(("ConfidenceThreshold", settings.confidence_threshold))
    if settings.frame_rate_hz > 0:
        wanted += [("AcquisitionFrameRateEnable", True), ("AcquisitionFrameRate", settings.frame_rate_hz)]
    lacking = [name for name, value in wanted if not features.set(name, value) and name not in DISPENSABLE]
    lacking += _set_limits(features, depth_mm)
    warnings = [f"the device has no feature {', '.join(lacking)}: it measures as it does"] if lacking else []
    return warnings + _set_components(features, settings)


def coordinates(features: Features) -> Coordinates | None:
    """What the stored coordinates of the range mean, as the device tells it; None if it tells no scale.

    Raises:
        DeviceError: it measures in a unit that is no length.
    """
    features.set("ComponentSelector", "Range")
    unit = features.get("Scan3dDistanceUnit") or "Millimeter"
    if unit not in UNITS_M:
        raise DeviceError(
            f"the device measures in {unit}: set Scan3dDistanceUnit to one of {', '.join(UNITS_M)}, "
            "or Scan3dOutputMode to a calibrated one"
        )
    scale, offset, invalid = [], [], 0.0
    for axis in AXES:
        features.set("Scan3dCoordinateSelector", axis)
        scale.append(features.get("Scan3dCoordinateScale"))
        offset.append(features.get("Scan3dCoordinateOffset") or 0.0)
        invalid = features.get("Scan3dInvalidDataValue") or 0.0
    if scale[-1] is None:
        return None
    flagged = features.get("Scan3dInvalidDataFlag") is not False
    scale = [scale[-1] if each is None else each for each in scale]
    return Coordinates(UNITS_M[unit], tuple(scale), tuple(offset), invalid if flagged else None)


def intrinsics(features: Features) -> Camera | None:
    """The pinhole camera that the device says it is; None if it does not say.

    A pixel (u, v), counted from 0, looks along ((u - PrincipalPointU) / f, (v - PrincipalPointV) / f, 1).
    """
    focal = features.get("Scan3dFocalLength")
    centre = features.get("Scan3dPrincipalPointU"), features.get("Scan3dPrincipalPointV")
    size = features.get("Width"), features.get("Height")
    if not focal or None in (*centre, *size):
        return None
    aspect = features.get("Scan3dAspectRatio") or 1.0
    return Camera(*map(int, size), float(focal), float(focal) * aspect, float(centre[0]), float(centre[1]))


def disagreement_px(camera: Camera, points_m: NDArray[np.float32]) -> tuple[float, float]:
    """How far the points (rows, cols, 3) of a device lie from the rays of their pixels: median in x and y [px].

    Not 0, 0 where the device counts its pixels or its principal point otherwise than `intrinsics` takes it, or
    corrects no distortion; NaN without any point.
    """
    rows, cols = np.nonzero(np.isfinite(points_m[..., 2]))
    if rows.size == 0:
        return np.nan, np.nan
    off = camera.project(points_m[rows, cols]) - np.stack([cols, rows], axis=-1)
    across, down = np.median(off, axis=0)
    return float(across), float(down)


def latch(features: Features) -> tuple[int, int, int] | None:
    """(time of the device's clock, host time before and after it was read) [ns]; None if it cannot be read.

    SFNC: TimestampLatch copies the clock of the device to TimestampLatchValue, in nanoseconds.
    """
    if features.get("TimestampLatchValue") is None:
        return None
    before_ns = time.time_ns()
    features.execute("TimestampLatch")
    after_ns = time.time_ns()
    device_ns = features.get("TimestampLatchValue")
    return None if not device_ns else (int(device_ns), before_ns, after_ns)


def _set_limits(features: Features, depth_mm: tuple[float, float]) -> list[str]:
    """DepthMin and DepthMax, in the order in which neither is ever on the wrong side of the other."""
    millimetres = {"DepthMin": round(depth_mm[0]), "DepthMax": round(depth_mm[1])}
    nearest = features.get("DepthMin")
    nearer = nearest is not None and depth_mm[1] <= nearest
    order = ("DepthMin", "DepthMax") if nearer else ("DepthMax", "DepthMin")
    return [name for name in order if not features.set(name, millimetres[name])]


def _set_components(features: Features, settings: TofSettings) -> list[str]:
    wanted = {
        "Range": (True, (settings.range_format, *RANGE_FORMATS, "Coord3D_C32f", "Coord3D_ABC32f_Planar")),
        "Intensity": (settings.intensity, ("Mono16", "Mono12", "Mono8")),
        "Confidence": (settings.confidence, ("Confidence16", "Confidence8")),
    }
    warnings = []
    there = features.choices("ComponentSelector")
    for component in there:
        enabled, formats = wanted.get(component, (False, ()))
        features.set("ComponentSelector", component)
        if not enabled:
            with contextlib.suppress(DeviceError):  # some cannot be switched off; they are then passed over
                features.set("ComponentEnable", False)
            continue
        features.set("ComponentEnable", True)
        possible = features.choices("PixelFormat")
        chosen = next((name for name in formats if name in possible), None)
        if chosen is None:
            raise DeviceError(
                f"component {component} of the device comes as {', '.join(possible)}; read are {', '.join(formats)}"
            )
        features.set("PixelFormat", chosen)
        if component == "Range" and chosen != settings.range_format:
            warnings.append(f"the device has no {settings.range_format}: its range comes as {chosen}")
    missing = [component for component, (enabled, _) in wanted.items() if enabled and component not in there]
    if missing:
        warnings.append(f"the device has no component {', '.join(missing)}")
    return warnings
