"""The settings of a ToF camera, named and limited as in the documentation of Basler's Blaze."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import SettingsError
from ..settings import Settings, setting

# Formats of the range that may be asked for; with a device that has none of them, any that is read is taken.
RANGE_FORMATS = ("Coord3D_C16", "Coord3D_ABC32f")


@dataclass(frozen=True)
class TofSettings(Settings):
    """The ToF camera and how it measures."""

    device: str = setting(
        "",
        doc="serial number, user-defined name, or address (gentl: the producer's device ID; pylon: the IP address); "
        "empty takes the only one there is",
    )
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
