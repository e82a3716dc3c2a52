"""Renders the images of the validation, each once: they stay in the output folder."""

from __future__ import annotations

import functools
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.simulator import motion, scene, sensors, speckle
from rgbd_dic_acquisition.simulator.motion import CrackState
from rgbd_dic_acquisition.simulator.scene import CrackedPanel
from rgbd_dic_acquisition.simulator.sensors import CameraModel, CameraSettings
from rgbd_dic_acquisition.simulator.speckle import SpeckleSettings, make_pattern

from rgbd_dic_acquisition import calibration

from ..digests import digest, digest_of_files
from .shots import PANEL, PATTERNS, SUPERSAMPLING, Shot

PATTERN_SEED = 2


def rendering_digest() -> str:
    """Of the code that the images depend on."""
    return digest_of_files(*(Path(module.__file__) for module in (calibration, motion, scene, sensors, speckle)))


class Renderer:
    """Grey levels as they fall on the sensor, without noise and rounding."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "images"
        self._folder.mkdir(parents=True, exist_ok=True)

    def radiance(self, shot: Shot, pattern: str | SpeckleSettings) -> NDArray[np.float32]:
        """(rows, cols), in grey levels; a pattern of `PATTERNS` or one's own, which is sampled as blobs are."""
        settings = PATTERNS[pattern] if isinstance(pattern, str) else pattern
        key = digest(rendering_digest(), settings.as_dict(), SUPERSAMPLING[settings.kind], PATTERN_SEED, shot.as_dict())
        path = self._folder / f"{settings.kind}_{key}.npy"
        if path.exists():
            return np.load(path)
        camera = CameraSettings(
            width_px=shot.camera.width, height_px=shot.camera.height, supersampling=SUPERSAMPLING[settings.kind]
        )
        model = CameraModel(shot.camera, camera, workers=1)
        grey = model.radiance(scene_of(settings), shot.pose, CrackState(shot.crack_mm * 1e-3)).astype(np.float32)
        save(path, grey)
        return grey


def exposed(radiance: NDArray[np.float32], noise: float = 0.0, seed: tuple[int, ...] = ()) -> NDArray[np.uint8]:
    """8 bit, with normal noise of this standard deviation [grey levels] added before rounding."""
    grey = radiance
    if noise:
        grey = radiance + np.random.default_rng(seed).normal(0, noise, radiance.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def save(path: Path, array: NDArray) -> None:
    """Write an array in one step, so that an interrupted run leaves no half of a file."""
    unfinished = path.with_suffix(f".{os.getpid()}")
    with unfinished.open("wb") as file:
        np.save(file, array)
    unfinished.replace(path)


@functools.lru_cache(maxsize=2)
def scene_of(settings: SpeckleSettings) -> CrackedPanel:
    """The panel with this pattern."""
    random = np.random.default_rng(PATTERN_SEED)
    return CrackedPanel(PANEL, make_pattern(settings, PANEL.width_m, PANEL.height_m, random))
