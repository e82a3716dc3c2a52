"""The simulated laboratory of the thesis' chapter 4: panel, press, hand-held sensors; the truth at every instant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..calibration import Calibration
from .laboratory_camera import LaboratoryCamera, Moment
from .laboratory_fields import Deformation, DeformationField
from .laboratory_motion import LaboratoryMotion, OrbitSettings, lossy
from .laboratory_panel import BendingPanel
from .laboratory_pattern import Texture
from .laboratory_press import Press
from .laboratory_reference import StereoReference
from .laboratory_regions import laboratory_regions, zone_pixels
from .laboratory_settings import LaboratorySettings, laboratory_settings
from .laboratory_tof import LaboratoryTof
from .motion import CrackState, Pose
from .sensors import BLAZE, FLIR, CameraSettings, TofImage, TofSettings, sensor_rig
from .timing import Ticks, ticks

__all__ = ["Exposure", "Laboratory", "LaboratorySettings", "laboratory_settings"]

Array = NDArray[np.float64]

# What each stream of random numbers is for; a stream is never shared, so that nothing depends on order.
(
    _PATTERN,
    _MOTION,
    _CAMERA,
    _TOF,
    _IMU,
    _CAMERA_TICKS,
    _TOF_TICKS,
    _IMU_TICKS,
    _CAMERA_FIXED,
    _TOF_FIXED,
    _CAMERA_LOSS,
    _TOF_LOSS,
    _STEREO,
) = range(13)


@dataclass(frozen=True)
class Exposure:
    """One frame that arrives: of the `camera` or the `tof`, by number; its stamp, and the true middle of its exposure.

    stamp_ns: since the start; as the driver says, which for the ToF sensor may be wrong by a constant.
    """

    sensor: str
    index: int
    time_s: float
    stamp_ns: int


class Laboratory:
    """What there is to see and to know at each moment.

    Truth, all exact: `pose`, `stroke_m`, `displacement`, `jump`, `project`, `material`, `crack`. Times are seconds
    since the start. Material has the coordinates of the unloaded panel, whose frame has its origin in the middle of the
    crack, x to the right, y down, z into the wall.

    Args:
        field: another deformation than the one that the settings name.

    Attributes:
        calibration: of both sensors, exact.
        camera_model, tof_model: the sensors.
    """

    def __init__(self, settings: LaboratorySettings, field: DeformationField | None = None) -> None:
        s = self.settings = settings
        width, height = s.panel.width_m, s.panel.height_m
        self.calibration = _rig(s)
        self.panel = BendingPanel(s.panel, Deformation(s.deformation, width, height, field))
        self.press = Press(s.press, s.duration_s)
        self._motion = LaboratoryMotion(s.motion, s.orbit, self._random(_MOTION))
        pixel_m = s.motion.distance_m / self.calibration.camera.fx
        texture = Texture(s.pattern, pixel_m, width, height, self._random(_PATTERN))
        self.camera_model = LaboratoryCamera(
            self.calibration.camera, s.camera, self.panel, texture, s.obstacle, self.moment, self._random(_CAMERA_FIXED)
        )
        average = LaboratoryMotion(replace(s.motion, sway_m=0.0, sway_rad=0.0), OrbitSettings(), self._random(_MOTION))
        self.tof_model = LaboratoryTof(
            self.calibration,
            s.tof,
            self.panel,
            texture,
            s.obstacle,
            Moment(average.pose(0.0), 0.0),
            self._random(_TOF_FIXED),
        )

    # Truth

    def pose(self, time_s: float) -> Pose:
        """T_camera_panel."""
        return self._motion.pose(time_s)

    def stroke_m(self, time_s: float) -> float:
        """Of the piston since the unloaded state."""
        return float(self.press.stroke(time_s))

    def moment(self, time_s: float) -> Moment:
        """Where all is."""
        bar = self.settings.obstacle.span_m(time_s, self.settings.panel.width_m)
        return Moment(self.pose(time_s), self.stroke_m(time_s), bar)

    def displacement(self, x_m: Array, y_m: Array, time_s: float, side: Array | int | None = None) -> Array:
        """(..., 3) of material in the panel frame since the reference, the first image [m]."""
        now, then = (
            self.panel.deformation.displacement(x_m, y_m, self.stroke_m(t), side) for t in (time_s, self.reference_s)
        )
        return now - then

    def jump(self, y_m: Array, time_s: float) -> Array:
        """(..., 3): opening, sliding and step of the crack at y since the reference [m]."""
        now, then = (self.panel.deformation.jump(y_m, self.stroke_m(t)) for t in (time_s, self.reference_s))
        return now - then

    def turn_rad(self, time_s: float) -> float:
        """How far the crack's middle has turned about the panel's z since the reference: the mean of its two sides."""
        step = 1e-4
        x, y = step * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)], float).T
        moved = np.mean([self.displacement(x, y, time_s, side) for side in (-1, 1)], axis=0)
        return float((moved[0, 1] - moved[1, 1]) - (moved[2, 0] - moved[3, 0])) / (4 * step)

    def project(self, x_m: Array, y_m: Array, time_s: float, side: Array | int | None = None) -> Array:
        """Raw pixels (..., 2) of material."""
        return self.panel.project(self.calibration.camera, self.pose(time_s), x_m, y_m, self.stroke_m(time_s), side)

    def material(self, pixels: Array, time_s: float) -> Array:
        """x, y (N, 2) of the material that raw pixels (N, 2) see [m]; NaN off the panel and in the crack."""
        camera, pose, stroke = self.calibration.camera, self.pose(time_s), self.stroke_m(time_s)
        rays, s = camera.rays(camera.undistort(np.asarray(pixels, float))), self.settings.panel
        found = np.full((len(rays), 2), np.nan)
        for side in (-1, 1):
            x, y, _ = self.panel.material(rays, pose, stroke, side)
            on_half = (side * x >= s.gap_m / 2) & (side * x <= s.width_m / 2) & (np.abs(y) <= s.height_m / 2)
            found[on_half] = np.column_stack([x, y])[on_half]
        return found

    @cached_property
    def reference_s(self) -> float:
        """Time of the reference: the first image."""
        return float(self.camera_ticks().exposed_ns[0]) * 1e-9

    @cached_property
    def regions(self) -> dict[str, Any]:
        """The content of regions.yaml for the first image."""
        return laboratory_regions(self)

    @cached_property
    def zones(self) -> tuple[Array, Array]:
        """Material (N, 2) of the left and of the right measuring zone of `regions`, evenly spread."""
        left, right = zone_pixels(self.regions["crack"])
        return self.material(left, self.reference_s), self.material(right, self.reference_s)

    def crack(self, time_s: float, zones: tuple[Array, Array] | None = None) -> CrackState:
        """Mean displacement of the right measuring zone minus that of the left one, since the reference: what a perfect
        measurement in those zones gives. `jump` is that of the crack itself.

        Args:
            zones: material of other points than `zones`, such as that of the subsets that a measurement averages:
                their mean may be some pixels off the middle of the zone, on what turns by some mrad.
        """
        left, right = (np.mean(self.displacement(*zone.T, time_s), axis=0) for zone in zones or self.zones)
        return CrackState(*(float(value) for value in right - left))

    @cached_property
    def stereo(self) -> StereoReference:
        """The 3D DIC system's history of the same zones."""
        return StereoReference(self.settings.stereo, self.crack, self.settings.duration_s, self._random(_STEREO))

    # Sensors

    def image(self, time_s: float, index: int) -> NDArray[np.uint8]:
        """Image (rows, cols) of an exposure centred at a time; the noise depends on the index alone."""
        return self.camera_model.expose(time_s, self._random(_CAMERA, index))

    def depth(self, time_s: float, index: int) -> TofImage:
        """ToF frame at a time; the noise depends on the index alone."""
        return self.tof_model.expose(self.moment(time_s), self._random(_TOF, index))

    def exposures(self) -> list[Exposure]:
        """All frames of both sensors in the order in which they arrive."""
        arriving = []
        for sensor, frames in (("camera", self.camera_ticks()), ("tof", self.tof_ticks())):
            for index, (exposed, arrived) in enumerate(zip(frames.exposed_ns, frames.arrived_ns, strict=True)):
                stamp_ns = int(exposed) + frames.stamp_delay_ns
                arriving.append((int(arrived), Exposure(sensor, index, exposed * 1e-9, stamp_ns)))
        return [exposure for _, exposure in sorted(arriving, key=lambda one: one[0])]

    def attitude_error(self, index: int) -> Array:
        """Rotation vector (3,) about the world's axes that the IMU is wrong by [rad]."""
        return self.settings.attitude_noise_rad * self._random(_IMU, index).standard_normal(3)

    def camera_ticks(self) -> Ticks:
        """Of the images that arrive."""
        t, loss = self.settings.timing, self.settings.loss
        all_ticks = self._ticks(_CAMERA_TICKS, t.camera_rate_hz, t.camera_skew_ppm, 0.0, t.camera_latency_s)
        return lossy(all_ticks, loss, loss.camera_drops, self._random(_CAMERA_LOSS))

    def tof_ticks(self) -> Ticks:
        """Of the ToF frames that arrive; their stamps are off by the delay of the settings."""
        t, loss = self.settings.timing, self.settings.loss
        phase_s = t.tof_phase_s + 0.25 / t.camera_rate_hz - 0.25 / t.tof_rate_hz
        all_ticks = self._ticks(_TOF_TICKS, t.tof_rate_hz, t.tof_skew_ppm, phase_s, t.tof_latency_s)
        arriving = lossy(all_ticks, loss, loss.tof_drops, self._random(_TOF_LOSS))
        return replace(arriving, stamp_delay_ns=round(loss.tof_delay_s * 1e9))

    def imu_ticks(self) -> Ticks:
        t = self.settings.timing
        return self._ticks(_IMU_TICKS, t.imu_rate_hz, 0.0, 0.0, t.imu_latency_s)

    def _ticks(self, stream: int, rate_hz: float, skew_ppm: float, phase_s: float, latency_s: float) -> Ticks:
        count = max(1, int(np.floor(self.settings.duration_s * rate_hz + 1e-9)))
        jitter_s = self.settings.timing.jitter_s
        rng = self._random(stream)
        return ticks(count, rate_hz, rng, phase_s=phase_s, skew_ppm=skew_ppm, jitter_s=jitter_s, latency_s=latency_s)

    def _random(self, *stream: int) -> np.random.Generator:
        return np.random.default_rng([self.settings.seed, *stream])


def _rig(settings: LaboratorySettings) -> Calibration:
    """Tables 4.4 and 4.5 at the scales of the settings."""
    camera, tof = settings.camera.scale, settings.tof.scale
    return sensor_rig(
        CameraSettings(width_px=round(FLIR.width * camera), height_px=round(FLIR.height * camera)),
        TofSettings(width_px=round(BLAZE.width * tof), height_px=round(BLAZE.height * tof)),
    )
