"""The two sensors: greyscale images by supersampling with the true lens, ToF depth with noise."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..calibration import Calibration, Camera
from ..settings import Settings, setting
from .motion import CrackState, Pose
from .scene import PAINTED, Scene, Sight

Array = NDArray[np.float64]

CHUNK_SAMPLES = 200_000  # rendered at a time, to stay within the processor's cache
RADII = 8193  # nodes at which the lens is inverted; between them linear, to 1e-10 of the radius

# The thesis' sensors (Tables 4.4 and 4.5), whose pixels are scaled to the size that is asked for.
FLIR = Camera(1440, 1080, 2458.5, 2465.9, 719.5, 539.5, 0.0084, 0.0843)
BLAZE = Camera(640, 480, 521.3, 522.2, 319.5, 239.5)
R_CAMERA_TOF = np.array([[0.9996, -0.0036, 0.0271], [0.0044, 0.9995, -0.0309], [-0.0270, 0.0310, 0.9992]])
T_CAMERA_TOF_M = np.array([-25.86e-3, -66.70e-3, 61.09e-3])


@dataclass(frozen=True)
class CameraSettings(Settings):
    """The greyscale camera."""

    width_px: int = setting(480, unit="px", low=16, high=10000, doc="columns; the lens stays the same")
    height_px: int = setting(360, unit="px", low=16, high=10000, doc="rows; the lens stays the same")
    supersampling: int = setting(4, low=1, high=32, doc="rays a pixel, in x and in y")
    gain: float = setting(1.0, low=0.0, high=100.0, doc="factor on the scene's grey levels")
    offset: float = setting(0.0, unit="grey levels", low=-255.0, high=255.0, doc="added to every pixel")
    read_noise: float = setting(0.8, unit="grey levels", low=0.0, high=100.0, doc="standard deviation in the dark")
    shot_noise: float = setting(
        0.003, unit="grey levels", low=0.0, high=10.0, doc="variance of a pixel for each grey level of light"
    )


@dataclass(frozen=True)
class TofSettings(Settings):
    """The ToF sensor."""

    width_px: int = setting(160, unit="px", low=8, high=4000, doc="columns; the lens stays the same")
    height_px: int = setting(120, unit="px", low=8, high=4000, doc="rows; the lens stays the same")
    range_noise_m: float = setting(0.005, unit="m", low=0.0, high=1.0, doc="standard deviation along a ray")
    near_m: float = setting(0.3, unit="m", low=0.0, high=65.0, doc="nearest range that gives a depth")
    far_m: float = setting(10.0, unit="m", low=0.0, high=65.0, doc="farthest range that gives a depth")
    dropouts: float = setting(0.005, low=0.0, high=1.0, doc="part of the pixels that give none, at random")


@dataclass(frozen=True)
class TofImage:
    """One ToF exposure, arrays (rows, cols): depth [m], NaN for none; intensity and confidence in 16 bits."""

    depth_m: Array
    intensity: NDArray[np.uint16]
    confidence: NDArray[np.uint16]


def sensor_rig(camera: CameraSettings, tof: TofSettings) -> Calibration:
    """Both sensors of the thesis at these resolutions, and T_camera_tof of Table 4.5 made orthonormal."""
    u, _, vt = np.linalg.svd(R_CAMERA_TOF)
    return Calibration(
        FLIR.scaled_to(camera.width_px, camera.height_px),
        BLAZE.scaled_to(tof.width_px, tof.height_px),
        u @ vt,
        T_CAMERA_TOF_M,
    )


class CameraModel:
    """Renders what the greyscale camera sees: the mean of s x s rays in each pixel, then noise and 8 bits."""

    def __init__(self, camera: Camera, settings: CameraSettings, workers: int | None = None) -> None:
        self.camera, self.settings = camera, settings
        self._workers = workers or os.cpu_count() or 1
        s = settings.supersampling
        self._columns = (np.arange(camera.width * s) + 0.5) / s - 0.5
        rows_a_chunk = max(1, CHUNK_SAMPLES // (camera.width * s * s))
        edges = [*range(0, camera.height, rows_a_chunk), camera.height]
        self._chunks = list(pairwise(edges))
        corners = np.array([[x, y] for x in (-1, camera.width) for y in (-1, camera.height)], float)
        reach = np.linalg.norm(camera.rays(corners)[:, :2], axis=1).max()
        self._radii = np.linspace(0, reach, RADII)
        on_axis = np.stack([camera.cx + camera.fx * self._radii, np.full(RADII, camera.cy)], axis=1)
        ideal = camera.rays(camera.undistort(on_axis))[:, 0]
        self._scale = np.concatenate([[1.0], ideal[1:] / self._radii[1:]])
        self._widest = max(1.0, float(np.max(np.diff(ideal) / np.diff(self._radii))))

    def radiance(self, scene: Scene, pose: Pose, crack: CrackState) -> Array:
        """Grey levels (rows, cols) without noise and rounding; `pose` is T_camera_panel."""
        with ThreadPoolExecutor(self._workers) as pool:
            return np.concatenate(list(pool.map(partial(self._rows, scene, pose, crack), self._chunks)))

    def _rows(self, scene: Scene, pose: Pose, crack: CrackState, chunk: tuple[int, int]) -> Array:
        s, (first, last), width = self.settings.supersampling, chunk, self.camera.width
        if s > 1:
            rays = self._rays(np.arange(width, dtype=float), np.arange(first, last, dtype=float)[:, None])
            sight = scene.look(rays, pose, crack)
            alike = scene.uniform(sight, crack, self._reach_m(rays, sight, pose))
            if alike is not None:
                grey = scene.grey(sight)
                rows, cols = np.nonzero(~alike)
                inner = (np.arange(s) + 0.5) / s - 0.5
                rays = self._rays(cols[:, None, None] + inner, first + rows[:, None, None] + inner[:, None])
                grey[rows, cols] = scene.grey(scene.look(rays, pose, crack)).mean(axis=(1, 2))
                return grey
        rows = first + (np.arange((last - first) * s) + 0.5) / s - 0.5
        sight = scene.look(self._rays(self._columns, rows[:, None]), pose, crack)
        return scene.grey(sight).reshape(last - first, s, width, s).mean(axis=(1, 3))

    def _reach_m(self, rays: Array, sight: Sight, pose: Pose) -> Array:
        """At least how far on the panel the corners of a pixel are from what its middle sees [m]."""
        slant = np.abs(rays @ pose.R[:, 2]) / np.linalg.norm(rays, axis=-1)
        half_diagonal = np.sqrt(0.5) / min(self.camera.fx, self.camera.fy)
        return 1.1 * self._widest * half_diagonal * sight.z_m / slant

    def expose(self, scene: Scene, pose: Pose, crack: CrackState, rng: np.random.Generator) -> NDArray[np.uint8]:
        """One image (rows, cols) with noise, in 8 bits."""
        s = self.settings
        light = s.gain * self.radiance(scene, pose, crack)
        sigma = np.sqrt(s.read_noise**2 + s.shot_noise * light)
        noisy = s.offset + light + sigma * rng.standard_normal(light.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def _rays(self, columns: Array, rows: Array) -> Array:
        """Directions (..., 3), z = 1, at raw pixel coordinates that broadcast to (...)."""
        camera = self.camera
        x = (columns - camera.cx) / camera.fx
        y = (rows - camera.cy) / camera.fy
        scale = np.interp(np.sqrt(x**2 + y**2), self._radii, self._scale)
        return np.moveaxis(np.stack([x * scale, y * scale, np.ones_like(scale)]), 0, -1)  # axes apart: faster


class TofModel:
    """Depth at the centre of each ToF pixel; every pixel is one ray."""

    def __init__(self, calibration: Calibration, settings: TofSettings) -> None:
        if calibration.tof is None:
            raise ValueError("a ToF model needs the calibration of a ToF sensor")
        self.camera, self.settings = calibration.tof, settings
        self._calibration = calibration
        rows, cols = np.mgrid[: self.camera.height, : self.camera.width]
        pixels = np.stack([cols, rows], axis=-1).reshape(-1, 2).astype(float)
        rays = self.camera.rays(self.camera.undistort(pixels))
        self._rays = rays.reshape(self.camera.height, self.camera.width, 3)

    def pose(self, T_camera_panel: Pose) -> Pose:
        """T_tof_panel from T_camera_panel."""
        R, t = self._calibration.R_camera_tof, self._calibration.t_camera_tof
        return Pose(R.T @ T_camera_panel.R, R.T @ (T_camera_panel.t - t))

    def expose(self, scene: Scene, T_camera_panel: Pose, crack: CrackState, rng: np.random.Generator) -> TofImage:
        """One frame."""
        s = self.settings
        sight = scene.look(self._rays, self.pose(T_camera_panel), crack)
        length = np.linalg.norm(self._rays, axis=-1)
        distance = sight.z_m * length + s.range_noise_m * rng.standard_normal(length.shape)
        lost = rng.random(length.shape) < s.dropouts
        valid = ~lost & (distance >= s.near_m) & (distance <= s.far_m)
        strength = scene.grey(sight) / np.maximum(sight.z_m * length, 0.1) ** 2
        intensity = np.clip(np.rint(2 * strength), 0, 65535)
        confidence = np.where(valid, np.where(sight.surface == PAINTED, 60000, 50000), 0)
        return TofImage(
            np.where(valid, distance / length, np.nan),
            intensity.astype(np.uint16),
            confidence.astype(np.uint16),
        )
