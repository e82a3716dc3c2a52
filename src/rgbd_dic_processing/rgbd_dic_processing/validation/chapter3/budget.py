"""What the spread of the subsets consists of: rounding, aliasing, interpolation, each by itself and all together.

A part of the panel is rendered ten times as fine. The mean over each pixel, as a sensor takes it, is sampled once as it
is and once after an ideal low-pass at the Nyquist frequency: the difference is aliasing. What is left without it and
without rounding is the interpolation between pixels and the second-order map of the subset.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.simulator.motion import CrackState
from rgbd_dic_acquisition.simulator.sensors import CameraModel, CameraSettings
from scipy import fft

from ...core.correlation import ReferenceSubsets
from ...core.geometry import plane_homography
from ...core.seed_maps import SeedMaps
from .measuring import exact_plane, footprint_m, project, true_px
from .rendering import exposed, scene_of
from .shots import PATTERNS, REFERENCES, Shot, all_shots
from .tasks import EXACT, PREFILTER_PX, STEP, SUBSET

Array = NDArray[np.float64]

FINE = 10  # samples a pixel in x and in y
SIDE_PX = 330  # of the part of the image
MARGIN_PX = 25  # beyond the subsets, where the low-pass takes the image to be periodic
MIDDLE_M = (-0.24, 0.0)  # of the part, on the left plate


def spread(folder: Path, pattern: str, reference: int, shot: int) -> dict[str, float]:
    """Standard deviations of the subsets' error along x, for the pictures with and without each cause [mm]."""
    base, view = REFERENCES[reference], all_shots()[shot]
    pictures = [_pictures(at, pattern) for at in (base, view)]
    corners = [_corner(at) for at in (base, view)]
    errors = {}
    for name in pictures[0]:
        for rounded in (False, True):
            pair = [picture[name].astype(np.float32) for picture in pictures]
            errors[name, rounded] = _errors(base, view, corners, [exposed(p) for p in pair] if rounded else pair)
    scale = 1e3 * footprint_m(base)

    def std(values: Array) -> float:
        return float(scale * np.nanstd(values, ddof=1))

    return {
        "total": std(errors["sampled", True]),
        "rounding": std(errors["sampled", True] - errors["sampled", False]),
        "aliasing": std(errors["sampled", False] - errors["alias-free", False]),
        "interpolation": std(errors["alias-free", False]),
        "pre-filtered": std(errors["pre-filtered", True]),
    }


def _pictures(shot: Shot, pattern: str) -> dict[str, Array]:
    """The part of the image (SIDE_PX, SIDE_PX) around the same material."""
    camera, (x, y) = shot.camera, _corner(shot)
    fine = Camera(
        SIDE_PX * FINE,
        SIDE_PX * FINE,
        camera.fx * FINE,
        camera.fy * FINE,
        (camera.cx - x + 0.5) * FINE - 0.5,
        (camera.cy - y + 0.5) * FINE - 0.5,
    )
    model = CameraModel(fine, CameraSettings(fine.width, fine.height, supersampling=1), workers=1)
    grey = model.radiance(scene_of(PATTERNS[pattern]), shot.pose, CrackState(shot.crack_mm * 1e-3))
    sampled = grey.reshape(SIDE_PX, FINE, SIDE_PX, FINE).mean(axis=(1, 3))
    return {
        "sampled": sampled,
        "alias-free": _alias_free(grey),
        "pre-filtered": cv2.GaussianBlur(sampled, (0, 0), PREFILTER_PX),
    }


def _alias_free(grey: Array) -> Array:
    """The mean over each pixel, without what is above the Nyquist frequency of the pixels."""
    spectrum = fft.rfft2(grey)
    rows, cols = fft.fftfreq(grey.shape[0])[:, None], fft.rfftfreq(grey.shape[1])[None, :]
    pixel = np.ones((1, 1))
    for frequency in (rows, cols):  # the mean of FINE samples about the pixel's middle
        offsets = np.arange(FINE) - (FINE - 1) / 2
        pixel = pixel * np.mean(np.cos(2 * np.pi * frequency[..., None] * offsets), axis=-1)
        pixel = pixel * (np.abs(frequency) < 0.5 / FINE)
    to_middle = np.exp(2j * np.pi * (rows + cols) * (FINE - 1) / 2)  # of the first pixel, between two samples
    return fft.irfft2(spectrum * pixel * to_middle, s=grey.shape)[::FINE, ::FINE]


def _errors(base: Shot, view: Shot, corners: list[NDArray[np.intp]], images: list[NDArray]) -> Array:
    """(N,) errors along x of all subsets [px], from the true maps."""
    half = SUBSET // 2 + MARGIN_PX
    ticks = np.arange(half, SIDE_PX - half, STEP // 2)
    centres = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2).astype(float)
    subsets = ReferenceSubsets(images[0], centres, EXACT)
    R = view.pose.R @ base.pose.R.T
    H = plane_homography(base.camera, R, view.pose.t - R @ base.pose.t, exact_plane(base))
    seeds = SeedMaps(base.camera, centres + corners[0], reach_px=SUBSET / 2).seeds(H)
    seeds[:, :, 0] -= corners[1]
    moved = subsets.correlate(subsets.target(images[1]), seeds)
    return moved.x_px + corners[1][0] - true_px(base, view, centres + corners[0])[:, 0]


def _corner(shot: Shot) -> NDArray[np.intp]:
    """The raw pixel (x, y) that is the first of the part."""
    return np.rint(project(shot, np.array([MIDDLE_M]))[0] - SIDE_PX / 2).astype(int)
