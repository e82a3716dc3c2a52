"""The ToF sensor of the laboratory: noise, dark reads farther, wiggle, flying pixels (thesis 4.2.1 and 4.3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..calibration import Calibration
from ..errors import SettingsError
from ..settings import Settings, setting
from .laboratory_camera import Moment
from .laboratory_motion import ObstacleSettings
from .laboratory_panel import LEFT, RIGHT, BendingPanel
from .laboratory_pattern import Texture
from .motion import Pose
from .sensors import TofImage

Array = NDArray[np.float64]

EDGE_M = 0.03  # step of the depth between neighbours that makes flying pixels
WHITE = 200.0  # grey level at which the noise and the offset of dark colours are those of the settings
RAYS_A_PIXEL = 3  # in x and in y, for the mean reflectance of a pixel: it is wider than a spot


@dataclass(frozen=True)
class LaboratoryTofSettings(Settings):
    """The Blaze of Table 4.3."""

    scale: float = setting(1.0, low=0.02, high=2.0, doc="pixels along a side as a part of 640 x 480; the same lens")
    residual_rms_m: float = setting(
        0.00497,
        unit="m",
        low=0.0,
        high=0.1,
        doc="RMS of z over the panel about the fitted plane (thesis 4.3.1); the noise is what makes it up; 0: no noise",
    )
    wiggle_m: float = setting(0.002, unit="m", low=0.0, high=0.1, doc="amplitude of the error that repeats in distance")
    wiggle_period_m: float = setting(0.375, unit="m", low=0.01, high=10.0, doc="its period along the ray")
    dark_offset_m: float = setting(0.006, unit="m", low=-0.1, high=0.1, doc="how much farther black reads than white")
    fixed_pattern_m: float = setting(
        0.0008, unit="m", low=0.0, high=0.1, doc="standard deviation of pixels' own offsets"
    )
    offset_m: float = setting(0.0, unit="m", low=-1.0, high=1.0, doc="constant error along every ray")
    near_m: float = setting(1.0, unit="m", low=0.0, high=65.0, doc="nearest range that gives a depth (thesis 4.2.1)")
    far_m: float = setting(3.0, unit="m", low=0.0, high=65.0, doc="farthest range that gives a depth")
    dropouts: float = setting(0.003, low=0.0, high=1.0, doc="part of the pixels that give none, at random")


class LaboratoryTof:
    """One exposure is one moment; each pixel is one ray, but sees the mean grey of its area.

    Error along the ray: wiggle sin(2 pi d / period + phase), the harmonic error of continuous-wave sensors [Rapp,
    thesis, Heidelberg 2007; Foix, Alenya and Torras, IEEE Sensors Journal 11 (2011) 1917]; an offset in proportion to
    what is missing to white; an offset of each pixel; and noise as one over the root of the reflected light, since
    sigma_d is about c / (4 pi f) sqrt(A + B) / A and the background is small. At an edge a pixel mixes both depths.

    Args:
        typical: the moment at which the noise is fitted to the RMS residual of the settings.

    Attributes:
        rays: (rows, cols, 3), z = 1.
        noise_m: standard deviation of the noise on white [m].
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: LaboratoryTofSettings,
        panel: BendingPanel,
        texture: Texture,
        obstacle: ObstacleSettings,
        typical: Moment,
        rng: np.random.Generator,
    ) -> None:
        self.camera, self.settings = calibration.tof, settings
        self._calibration, self._panel, self._texture, self._obstacle = calibration, panel, texture, obstacle
        pixels = np.stack(np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height)), axis=-1)
        self.rays = self.camera.rays(self.camera.undistort(pixels.reshape(-1, 2))).reshape(*pixels.shape[:2], 3)
        self._length = np.linalg.norm(self.rays, axis=-1)
        self._phase = rng.uniform(0, 2 * np.pi)
        self._own = settings.fixed_pattern_m * rng.standard_normal(self._length.shape)
        self.noise_m = self._fitted_noise(typical)

    def pose(self, T_camera_panel: Pose) -> Pose:
        """T_tof_panel from T_camera_panel."""
        R, t = self._calibration.R_camera_tof, self._calibration.t_camera_tof
        return Pose(R.T @ T_camera_panel.R, R.T @ (T_camera_panel.t - t))

    def look(self, moment: Moment) -> tuple[Array, Array]:
        """Exact depth along z [m] and mean grey level of every pixel (rows, cols)."""
        s, pose = self._panel.settings, self.pose(moment.pose)
        centre, towards = -pose.R.T @ pose.t, self.rays @ pose.R
        depth = (s.wall_offset_m - centre[2]) / towards[..., 2]
        grey = np.full(depth.shape, s.wall_grey)
        for side in (LEFT, RIGHT):
            window = self._panel.window(self.camera, pose, moment.stroke_m, side)
            if window is not None:
                into_crack = window.pixel_x_m if side == LEFT else 0.0  # which is narrower than a pixel
                inside = self._panel.coverage(window, side)[1] > 0.5
                on_half = inside & (side * window.x_m > -into_crack)
                depth[window.rows, window.cols][on_half] = window.depth_m[on_half]
                shifts = (np.arange(RAYS_A_PIXEL) + 0.5) / RAYS_A_PIXEL - 0.5
                x, y = window.x_m[on_half], window.y_m[on_half]
                spots = [
                    self._texture.grey(x + i * window.pixel_x_m, y + j * window.pixel_y_m)
                    for i in shifts
                    for j in shifts
                ]
                grey[window.rows, window.cols][on_half] = np.mean(spots, axis=0)
        if moment.bar_m is not None:
            plane = self._panel.in_front(self.camera, pose, self._obstacle.distance_m)
            hidden = (plane.x_m > moment.bar_m[0]) & (plane.x_m < moment.bar_m[1])
            depth[hidden], grey[hidden] = plane.depth_m[hidden], self._obstacle.grey
        return depth, grey

    def systematic(self, depth_m: Array, grey: Array) -> Array:
        """Error along the ray [m] that is the same in every frame of the same scene."""
        s = self.settings
        wiggle = s.wiggle_m * np.sin(2 * np.pi * depth_m * self._length / s.wiggle_period_m + self._phase)
        return s.offset_m + wiggle + s.dark_offset_m * np.clip(1 - grey / WHITE, 0, 1) + self._own

    def expose(self, moment: Moment, rng: np.random.Generator) -> TofImage:
        """One frame."""
        s = self.settings
        exact, grey = self.look(moment)
        near, far = ndimage.minimum_filter(exact, 3), ndimage.maximum_filter(exact, 3)
        part, noise, lost = rng.random(exact.shape), rng.standard_normal(exact.shape), rng.random(exact.shape)
        depth = np.where(far - near > EDGE_M, near + part * (far - near), exact)
        distance = depth * self._length + self.systematic(depth, grey) + self.noise_m * _relative_noise(grey) * noise
        valid = (lost >= s.dropouts) & (distance >= s.near_m) & (distance <= s.far_m)
        strength = np.clip(np.rint(40 * grey / np.maximum(distance, 0.1) ** 2), 0, 65535)
        return TofImage(
            np.where(valid, distance / self._length, np.nan),
            strength.astype(np.uint16),
            np.where(valid, 60000, 0).astype(np.uint16),
        )

    def _fitted_noise(self, moment: Moment) -> float:
        """The noise with which the RMS residual of z about the panel's plane is that of the settings.

        Raises:
            SettingsError: the other errors alone leave more.
        """
        s, pose = self.settings, self.pose(moment.pose)
        if s.residual_rms_m == 0:
            return 0.0
        depth, grey = self.look(moment)
        on_panel = np.abs((self.rays * depth[..., None] - pose.t) @ pose.R[:, 2]) < EDGE_M
        off = (depth + self.systematic(depth, grey) / self._length)[on_panel]
        points = self.rays[on_panel] * off[:, None]
        plane = np.column_stack([points[:, :2], np.ones(len(points))])
        fixed = off - plane @ np.linalg.lstsq(plane, off, rcond=None)[0]
        fixed_rms = float(np.sqrt(np.mean(fixed**2)))
        if fixed_rms > s.residual_rms_m:
            raise SettingsError(
                f"LaboratoryTofSettings.residual_rms_m = {s.residual_rms_m} m: the errors that are no noise leave "
                f"{fixed_rms:.5f} m already; make them smaller, or set 0 for no noise"
            )
        factor = np.mean((_relative_noise(grey) / self._length)[on_panel] ** 2)
        return float(np.sqrt((s.residual_rms_m**2 - fixed_rms**2) / factor))


def _relative_noise(grey: Array) -> Array:
    return np.sqrt(WHITE / np.clip(grey, 5.0, None))
