"""The features of a ToF camera by their GenICam names: setting it up, and what its numbers mean.

Names and units are those of Basler's Blaze (product documentation: Operating Mode, Fast Mode, ROI (blaze),
Component Selector, Pixel Format (blaze), Processing Measurement Results) and of GenICam's SFNC. What a device
lacks is left as it is and told; what it refuses is an error.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..calibration import Camera
from ..errors import DeviceError, SettingsError
from ..settings import Settings, setting
from .tof_components import Coordinates

AXES = ("CoordinateA", "CoordinateB", "CoordinateC")
UNITS_M = {"Millimeter": 1e-3, "Meter": 1.0, "Micrometer": 1e-6}
DISPENSABLE = ("TriggerMode", "AcquisitionMode", "AcquisitionFrameRateEnable", "GenDCStreamingMode")
# Formats of the range in which `range_format` may be given; with a device that has none of them, any that is read.
RANGE_FORMATS = ("Coord3D_C16", "Coord3D_ABC32f")


@dataclass(frozen=True)
class TofSettings(Settings):
    """The ToF camera and how it measures."""

    device: str = setting("", doc="serial number, user-defined name or IP address; empty takes the only one there is")
    producer: str = setting(
        "", doc="gentl: path of the GenTL producer (.cti); empty takes those in the folders of GENICAM_GENTL64_PATH"
    )
    long_range: bool = setting(True, doc="OperatingMode LongRange, needed beyond 1.5 m, in place of ShortRange")
    fast_mode: bool = setting(False, doc="FastMode: four subframes for a frame in place of eight, with more noise")
    depth_min_m: float = setting(0.3, doc="DepthMin: nearer depth is dropped", unit="m", low=0.0, high=10.0)
    depth_max_m: float = setting(5.0, doc="DepthMax: farther depth is dropped", unit="m", low=0.0, high=10.0)
    frame_rate_hz: float = setting(
        20.0, doc="AcquisitionFrameRate; 0 leaves the device's own", unit="Hz", low=0.0, high=60.0
    )
    exposure_s: float = setting(0.0, doc="ExposureTime; 0 leaves the device's own", unit="s", low=0.0, high=0.1)
    confidence_threshold: int = setting(
        -1, doc="ConfidenceThreshold below which depth is dropped; -1 leaves the device's own", low=-1, high=65535
    )
    range_format: str = setting(
        "Coord3D_C16",
        doc="PixelFormat of the range: depth alone in steps of a sixth of a millimetre, or points",
        choices=RANGE_FORMATS,
    )
    intensity: bool = setting(True, doc="whether the device sends the intensity too")
    confidence: bool = setting(True, doc="whether the device sends the confidence too")
    gendc: bool = setting(
        True, doc="GenDCStreamingMode: frames as containers that name their components, in place of multi-part buffers"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.depth_min_m >= self.depth_max_m:
            raise SettingsError(
                f"depth_min_m = {self.depth_min_m} m must be below depth_max_m = {self.depth_max_m} m: "
                "set both around the distances that matter"
            )


@dataclass(frozen=True)
class Features:
    """The features of an open device.

    Attributes:
        find: the node of a name; None or an error if there is none.
        errors: what the library raises.
        denied: which of them says that a feature cannot be written now.
        attribute: how the library spells the attributes of a node: "value" -> "value" or "Value".
    """

    find: Callable[[str], Any]
    errors: tuple[type[Exception], ...]
    denied: type[Exception]
    attribute: Callable[[str], str]

    def get(self, name: str) -> Any:
        """The value, or None if the device has no such feature or does not tell."""
        return self._read(name, "value")

    def set(self, name: str, value: Any) -> bool:
        """Set it; whether the device has it.

        Raises:
            DeviceError: it has, but refuses the value.
        """
        present = self.get(name)
        if present is None:
            return False
        try:
            setattr(self.find(name), self.attribute("value"), value)
        except self.errors as error:
            if present == value and isinstance(error, self.denied):
                return True
            told = str(error).strip().splitlines()
            raise DeviceError(
                f"the device refuses {name} = {value}{self._allowed(name)}: {told[0] if told else error!r}"
            ) from error
        return True

    def choices(self, name: str) -> tuple[str, ...]:
        """What an enumeration can be set to now."""
        return tuple(self._read(name, "symbolics") or ())

    def _allowed(self, name: str) -> str:
        if choices := self.choices(name):
            return f" (possible: {', '.join(choices)})"
        low, high = self._read(name, "min"), self._read(name, "max")
        return "" if low is None or high is None else f" (possible: {low:g} to {high:g})"

    def _read(self, name: str, attribute: str) -> Any:
        try:
            return getattr(self.find(name), self.attribute(attribute), None)
        except self.errors:
            return None


def set_up(features: Features, settings: TofSettings) -> list[str]:
    """Set up a device that is not streaming; what it could not do, in words.

    Raises:
        DeviceError: the device refuses a setting.
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


def coordinates(features: Features) -> Coordinates:
    """What the stored coordinates of the range mean, as the device tells it.

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
        scale.append(_number(features, "Scan3dCoordinateScale", 1.0))
        offset.append(_number(features, "Scan3dCoordinateOffset", 0.0))
        invalid = _number(features, "Scan3dInvalidDataValue", 0.0)
    flagged = features.get("Scan3dInvalidDataFlag") is not False
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
    aspect = _number(features, "Scan3dAspectRatio", 1.0)
    return Camera(*map(int, size), float(focal), float(focal) * aspect, float(centre[0]), float(centre[1]))


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


def _number(features: Features, name: str, default: float) -> float:
    value = features.get(name)
    return default if value is None else float(value)
