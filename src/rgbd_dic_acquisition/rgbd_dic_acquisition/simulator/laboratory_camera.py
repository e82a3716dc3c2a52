"""The greyscale camera of the laboratory: exact rendering, motion blur, lamps, lens shading, photons and 8 bits."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..calibration import Camera
from ..settings import Settings, setting
from .laboratory_motion import ObstacleSettings
from .laboratory_panel import LEFT, RIGHT, BendingPanel, Window, ramp
from .laboratory_pattern import Texture
from .motion import Pose

Array = NDArray[np.float64]
Image32 = NDArray[np.float32]

SHARP_PX = 0.02  # motion during the exposure below which one moment stands for all


@dataclass(frozen=True)
class LaboratoryCameraSettings(Settings):
    """The FLIR of Table 4.2, with the lens of Table 4.4, and the lamps."""

    scale: float = setting(1.0, low=0.02, high=2.0, doc="pixels along a side as a part of 1440 x 1080; the same lens")
    exposure_s: float = setting(0.002, unit="s", low=0.0, high=1.0, doc="motion blur is over this time (thesis 4.2.1)")
    gain_db: float = setting(10.0, unit="dB", low=0.0, high=48.0, doc="gain 10 of the thesis; the maker counts in dB")
    full_well_e: float = setting(10500.0, unit="electrons", low=100.0, high=1e6, doc="that give 255 at 0 dB")
    read_noise_e: float = setting(2.3, unit="electrons", low=0.0, high=1000.0, doc="noise in the dark")
    fixed_pattern: float = setting(0.005, low=0.0, high=0.2, doc="standard deviation of the pixels' sensitivities")
    vignetting: float = setting(0.25, low=0.0, high=0.95, doc="loss of light in the corners of the image")
    flicker: float = setting(0.05, low=0.0, high=1.0, doc="amplitude of the lamps' flicker")
    mains_hz: float = setting(50.0, unit="Hz", low=1.0, high=400.0, doc="lamps flicker at twice this")
    lamp_gradient: float = setting(0.15, low=-0.9, high=0.9, doc="light at the right edge over that in the middle, - 1")
    exposure_factor: float = setting(1.0, low=0.05, high=4.0, doc="brightness of every other stretch of time")
    exposure_every_s: float = setting(1.5, unit="s", low=0.02, high=1e4, doc="length of those stretches")
    noise: bool = setting(True, doc="photon, read and fixed-pattern noise; without it, light is only rounded")


@dataclass(frozen=True)
class Moment:
    """Where all is at one moment: T_camera_panel, the piston, and the x [m] of an obstacle's edges at its z."""

    pose: Pose
    stroke_m: float
    bar_m: tuple[float, float] | None = None


class LaboratoryCamera:
    """Renders images; what does not change from image to image is made once.

    Args:
        scene_at: where all is at a time [s].
        rng: of what is fixed: sensitivities and phase of the lamps.

    Attributes:
        texture: the pattern.
        response: (rows, cols) lens shading times each pixel's sensitivity.
    """

    def __init__(
        self,
        camera: Camera,
        settings: LaboratoryCameraSettings,
        panel: BendingPanel,
        texture: Texture,
        obstacle: ObstacleSettings,
        scene_at: Callable[[float], Moment],
        rng: np.random.Generator,
    ) -> None:
        self.camera, self.settings, s = camera, settings, settings
        self._panel, self.texture, self._obstacle, self._scene_at = panel, texture, obstacle, scene_at
        rows, cols = np.ogrid[: camera.height, : camera.width]
        middle = (camera.height - 1) / 2, (camera.width - 1) / 2
        radius2 = ((rows - middle[0]) ** 2 + (cols - middle[1]) ** 2) / (middle[0] ** 2 + middle[1] ** 2)
        self._lamp_phase = rng.uniform(0, 2 * np.pi)
        unlike = s.fixed_pattern if s.noise else 0.0
        sensitivity = 1 + np.float32(unlike) * rng.standard_normal(radius2.shape, np.float32)
        self.response = ((1 - s.vignetting * radius2) * sensitivity).astype(np.float32)

    @property
    def electrons_a_grey_level(self) -> float:
        """At the set gain."""
        return self.settings.full_well_e / 10 ** (self.settings.gain_db / 20) / 255

    def lamps(self, time_s: float, over_s: float = 0.0) -> float:
        """Light of the lamps at a moment, or the mean around it over a time, by that of a long time."""
        flicker_hz = 2 * self.settings.mains_hz
        wave = np.cos(2 * np.pi * flicker_hz * time_s + self._lamp_phase) * np.sinc(flicker_hz * over_s)
        return float(1 + self.settings.flicker * wave)

    def brightness(self, time_s: float) -> float:
        """Factor that a change of the exposure or the gain gives to an image."""
        odd = int(time_s // self.settings.exposure_every_s) % 2
        return self.settings.exposure_factor if odd else 1.0

    def instant(self, moment: Moment) -> Image32:
        """Grey levels (rows, cols) of the scene at one moment: without blur, shading, flicker and noise."""
        s, shape = self._panel.settings, (self.camera.height, self.camera.width)
        light, covered, body = (np.zeros(shape, np.float32) for _ in range(3))
        with ThreadPoolExecutor(2) as pool:
            for window, half_light, half, inside in filter(None, pool.map(partial(self._half, moment), (LEFT, RIGHT))):
                at = window.rows, window.cols
                light[at] += half_light
                covered[at] += half
                body[at] = np.maximum(body[at], inside)
        crowded = covered > body + 1e-6  # faces pressed into each other share the pixel
        light[crowded] *= body[crowded] / covered[crowded]
        light += s.gap_grey * np.maximum(body - covered, 0) + s.wall_grey * (1 - body)
        if moment.bar_m is not None:
            plane = self._panel.in_front(self.camera, moment.pose, self._obstacle.distance_m)
            low, high = moment.bar_m
            hidden = ramp((plane.x_m - low) / plane.pixel_x_m) * ramp((high - plane.x_m) / plane.pixel_x_m)
            light += hidden.astype(np.float32) * (self._obstacle.grey - light)
        return light

    def _half(self, moment: Moment, side: int) -> tuple[Window, Image32, Image32, Image32] | None:
        """One half in its window: light times coverage, coverage, and coverage by the body."""
        window = self._panel.window(self.camera, moment.pose, moment.stroke_m, side)
        if window is None:
            return None
        half, body = (part.astype(np.float32) for part in self._panel.coverage(window, side))
        lamps = 1 + self.settings.lamp_gradient * 2 / self._panel.settings.width_m * window.x_m
        light = self.texture.grey(window.x_m, window.y_m) * half
        light *= lamps.astype(np.float32)
        return window, light, half, body

    def radiance(self, time_s: float) -> Image32:
        """Grey levels (rows, cols) of an exposure centred at a time, without noise and rounding.

        The mean over the exposure is Gauss's quadrature with one node more than the pixels that the panel moves by, or
        the radians that the lamps go through to either side: spots are band-limited, so what it leaves out is below
        0.05 grey levels.
        """
        span, travel = self.settings.exposure_s, self.motion_px(time_s)
        if travel < SHARP_PX:
            light = np.float32(self.lamps(time_s, span)) * self.instant(self._scene_at(time_s))
        else:
            count = 1 + int(np.ceil(max(travel, 2 * np.pi * self.settings.mains_hz * span)))
            nodes, weights = np.polynomial.legendre.leggauss(count)
            light = np.zeros(self.response.shape, np.float32)
            for t, weight in zip(time_s + 0.5 * span * nodes, weights, strict=True):
                light += np.float32(0.5 * weight * self.lamps(t)) * self.instant(self._scene_at(t))
        return light * self.response * np.float32(self.brightness(time_s))

    def motion_px(self, time_s: float) -> float:
        """The farthest that a corner of the panel, or its middle, moves in the image during the exposure."""
        x, y = np.array([(0, 0), (-1, -1), (1, -1), (1, 1), (-1, 1)]).T * 0.5
        w, h, half = self._panel.settings.width_m, self._panel.settings.height_m, self.settings.exposure_s / 2
        start, end = (
            self._panel.project(self.camera, moment.pose, w * x, h * y, moment.stroke_m)
            for moment in (self._scene_at(time_s - half), self._scene_at(time_s + half))
        )
        return float(np.max(np.linalg.norm(end - start, axis=1)))

    def expose(self, time_s: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """One image (rows, cols) in 8 bits.

        Photon transfer [EMVA Standard 1288]: with k electrons a grey level, the variance of a pixel with light L is
        L / k + (read noise / k)^2 grey levels squared; photons are normal to a good approximation from some 50 on.
        """
        light = self.radiance(time_s)
        if self.settings.noise:
            k = self.electrons_a_grey_level
            sigma = np.sqrt(light / np.float32(k) + np.float32((self.settings.read_noise_e / k) ** 2))
            light += sigma * rng.standard_normal(light.shape, np.float32)
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)
