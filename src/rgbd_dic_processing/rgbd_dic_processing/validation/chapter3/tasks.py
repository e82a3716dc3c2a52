"""The pieces of work of the validation: each takes plain values and returns plain values, so that it can be cached and
run in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from ...core.correlation import CorrelationSettings
from ...core.geometry import apply_homography
from ...core.homography import fit_homography
from . import calibrating
from .measuring import (
    Measured,
    Tracked,
    footprint_m,
    measure,
    moving_part_mm,
    panel_per_pixel,
    panel_regions,
    track,
    track_again,
    true_px,
)
from .rendering import Renderer, exposed
from .shots import REFERENCES, Shot, all_shots
from .thesis import printed_camera

Array = NDArray[np.float64]
Summary = dict[str, dict[str, float]]

SUBSET, STEP = 31, 10
SETTINGS = CorrelationSettings(subset_size=SUBSET, step=STEP, threads=1)
EXACT = CorrelationSettings(subset_size=SUBSET, step=STEP, threads=1, tolerance_px=1e-6)
QUANTISATION = 1 / np.sqrt(12)  # grey levels, standard deviation of rounding
PREFILTER_PX = 0.8  # sigma of the Gaussian on both images
SAMPLES = 100  # minimal samples of four subsets tried a pair


def board(folder: Path, view: int) -> Any:
    """Corners found in one view of the checkerboard [px]."""
    return calibrating.board_corners(view).tolist()


def calibration(folder: Path, corners: list[list[list[float]]]) -> Any:
    """The camera, from the corners of all views [px]."""
    return calibrating.calibrate([np.array(points) for points in corners])


def blobs(folder: Path, reference: int, shot: int, calibrated: list[float]) -> Any:
    """A pair with the band-limited pattern: as 8-bit images and unrounded, with three calibrations, with plain subsets.

    Args:
        calibrated: fx, fy, cx, cy, k1, k2 of the calibration.
    """
    base, view, exact = _views(folder, "blobs", reference, shot)
    images = exposed(exact[0]), exposed(exact[1])
    tracked = track(base, images, SETTINGS)
    camera = Camera(base.camera.width, base.camera.height, *calibrated)
    results = {
        "8 bit": tracked,
        "unrounded": track_again(tracked, base, exact, EXACT),
        "unrounded, one map": track_again(tracked, base, exact, EXACT, "of the image"),
        "affine": track_again(tracked, base, images, SETTINGS, "affine"),
    }
    summaries = {name: summarise(measure(result, base, view), base, view) for name, result in results.items()}
    seen = {"calibrated": camera, "printed": printed_camera()}
    for name, K in seen.items():
        summaries[name] = summarise(measure(track(base, images, SETTINGS, K), base, view, K), base, view)
    return {
        "summaries": summaries,
        "minimal": minimal_samples(tracked, base, view),
        "floor_mm": quantisation_floor_mm(exact[0], tracked, base, view),
        "subsets": [int(np.isfinite(tracked.moved_px[:, 0]).sum()), len(tracked.moved_px)],
    }


def disks(folder: Path, reference: int, shot: int) -> Any:
    """A pair with the thesis' disks: as they are, with a pre-filter, and with plain affine subsets."""
    base, view, exact = _views(folder, "disks", reference, shot)
    images = exposed(exact[0]), exposed(exact[1])
    smooth = tuple(exposed(cv2.GaussianBlur(picture, (0, 0), PREFILTER_PX)) for picture in exact)
    tracked = track(base, images, SETTINGS)
    results = {
        "8 bit": tracked,
        "pre-filtered": track(base, smooth, SETTINGS),
        "affine": track_again(tracked, base, images, SETTINGS, "affine"),
    }
    summaries = {name: summarise(measure(result, base, view), base, view) for name, result in results.items()}
    return {"summaries": summaries, "floor_mm": quantisation_floor_mm(exact[0], tracked, base, view)}


def noisy(folder: Path, reference: int, shot: int, noise: float, realisations: int) -> Any:
    """How often the truth lies within two standard uncertainties: of the subsets' coordinates, and of the openings.

    Each realisation has noise of its own, and light that is a fraction of a grey level brighter, so that no two of them
    share their rounding.
    """
    base, view, exact = _views(folder, "blobs", reference, shot)
    within, of, squares = 0, 0, 0.0
    openings: dict[str, list[float]] = {}
    for realisation in range(realisations):
        seed = (reference, shot, realisation, round(10 * noise))
        brighter = np.random.default_rng(seed).uniform(0, 1, 2).astype(np.float32)
        images = tuple(exposed(exact[i] + brighter[i], noise, (*seed, i)) for i in (0, 1))
        tracked = track(base, images, SETTINGS)
        error_px = tracked.moved_px - true_px(base, view, tracked.reference.centres_px)
        ratio = (error_px / tracked.fields[1].sigma_px)[_on_plates(tracked, base)]
        within, of, squares = (
            within + int((np.abs(ratio) <= 2).sum()),
            of + ratio.size,
            squares + float(np.sum(ratio**2)),
        )
        for method, measured in measure(tracked, base, view).items():
            opening = measured.opening
            ratio_of_opening = (opening.opening_m - view.crack_mm * 1e-3) / opening.u_opening_m
            openings.setdefault(method, []).append(ratio_of_opening)
    return {"within": within, "of": of, "squares": squares, "openings": openings}


def summarise(measured: dict[str, Measured], reference: Shot, shot: Shot) -> Summary:
    """Of each method: average, standard deviation and RMS error (Eq. 2.8) of the moving part, the opening [mm]."""
    summaries = {}
    for method, one in measured.items():
        lengths = moving_part_mm(one, reference)
        summaries[method] = {
            "average": float(lengths.mean()),
            "std_dev": float(lengths.std(ddof=1)),
            "rms_error": float(np.sqrt(np.sum((lengths - shot.crack_mm) ** 2) / (len(lengths) - 1))),
            "opening": one.opening.opening_m * 1e3,
            "u_opening": one.opening.u_opening_m * 1e3,
        }
    return summaries


def minimal_samples(tracked: Tracked, reference: Shot, shot: Shot) -> list[float]:
    """Errors of the average of the moving part [mm] if h_2d's homography rests on four subsets and is not refined.

    With a threshold of a pixel or more all subsets agree with the first sample, so plain sample consensus ends there.
    """
    random = np.random.default_rng([reference.number, shot.number])
    camera, centres = reference.camera, tracked.reference.centres_px
    left, right = panel_regions(reference, SUBSET).crack.members(centres)
    source, target = camera.undistort(centres), camera.undistort(tracked.moved_px)
    left, right = (zone[np.isfinite(target[zone, 0])] for zone in (left, right))
    scale = 1e3 * panel_per_pixel(reference, source[right])
    errors = []
    while len(errors) < SAMPLES:
        four = random.choice(left, 4, replace=False)
        try:
            H = fit_homography(source[four], target[four])
        except np.linalg.LinAlgError:
            continue
        if H is None or np.linalg.norm(target[left] - apply_homography(H, source[left]), axis=1).max() > 1.5:
            continue
        restored = apply_homography(np.linalg.inv(H), target[right])
        moved = np.linalg.norm(np.einsum("nij,nj->ni", scale, restored - source[right]), axis=1)
        errors.append(float(np.nanmean(moved) - shot.crack_mm))
    return errors


def quantisation_floor_mm(exact: NDArray[np.float32], tracked: Tracked, reference: Shot, shot: Shot) -> float:
    """Standard deviation of a subset's displacement along x that rounding both images causes [mm], median.

    sigma_g sqrt(1 + 1/J) / sqrt(sum f_x^2), where J is the area of the panel's pixel in the reference over that in the
    image: if the image shows the panel smaller, fewer pixels tell of a subset.
    """
    grey = exact.astype(float)
    slope = (8 * (np.roll(grey, -1, 1) - np.roll(grey, 1, 1)) - np.roll(grey, -2, 1) + np.roll(grey, 2, 1)) / 12
    sums = cv2.boxFilter(slope**2, -1, (SUBSET, SUBSET), normalize=False)
    _, right = panel_regions(reference, SUBSET).crack.members(tracked.reference.centres_px)
    columns, rows = np.rint(tracked.reference.centres_px[right]).astype(int).T
    area = (footprint_m(reference) / footprint_m(shot)) ** 2
    sigma_px = QUANTISATION * np.sqrt(1 + 1 / area) / np.sqrt(sums[rows, columns])
    return float(1e3 * footprint_m(reference) * np.median(sigma_px))


def _views(folder: Path, pattern: str, reference: int, shot: int) -> tuple[Shot, Shot, tuple[NDArray, NDArray]]:
    base, view = REFERENCES[reference], all_shots()[shot]
    renderer = Renderer(folder)
    return base, view, (renderer.radiance(base, pattern), renderer.radiance(view, pattern))


def _on_plates(tracked: Tracked, reference: Shot) -> NDArray[np.intp]:
    zones = np.concatenate(panel_regions(reference, SUBSET).crack.members(tracked.reference.centres_px))
    return zones[np.isfinite(tracked.moved_px[zones, 0])]
