"""The calibration from top to bottom: shots of boards in, both sensors with their uncertainties out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rgbd_dic_acquisition.errors import CalibrationError

from .alone import calibrate_alone, relative_poses
from .board import Board
from .bundle import adjust
from .depth_bias import DepthBias, depth_bias
from .estimate import Estimate
from .model import Model
from .settings import CalibratingSettings
from .sources import Source
from .sufficiency import missing, too_uncertain
from .views import SENSORS, WORDS, BoardView, Gathering, Skipped

MOST_REASONS, MOST_NAMES = 6, 3  # that a refusal names, of skipped images


@dataclass(frozen=True)
class Calibrated:
    """All that the report shows.

    Attributes:
        views: the boards that were used, in the order of `estimate.poses`.
        skipped: images that were not.
        bias: of the ToF sensor's range; None without depth.
        notes: what was assumed, in sentences.
    """

    board: Board
    settings: CalibratingSettings
    estimate: Estimate
    views: tuple[BoardView, ...]
    skipped: tuple[Skipped, ...]
    bias: DepthBias | None
    notes: tuple[str, ...]


def calibrate(
    source: Source, board: Board, settings: CalibratingSettings, advance: Callable[[], None] | None = None
) -> Calibrated:
    """Both sensors, or the camera alone if there are no ToF images.

    Args:
        advance: called after each shot.

    Raises:
        CalibrationError: the boards do not suffice (with what is missing), contradict each other or the depth.
        ImageError, BagError: the images cannot be read, or do not belong together.
    """
    gathering = Gathering(source, board, advance)
    gathering.screen(settings)
    if not gathering.views:
        raise CalibrationError(_refusal("there is no usable board", [f"looked for: {board.words}"], gathering))
    if "camera" not in gathering.sizes:
        raise CalibrationError("there are ToF images, but no camera images: the camera is always calibrated")
    models = {
        sensor: Model(*size, settings.principal_point == "free", sensor == "camera" or settings.tof_distortion)
        for sensor, size in gathering.sizes.items()
    }
    while True:
        if wants := missing(gathering, board, models, settings):
            raise CalibrationError(_refusal("the boards do not suffice", wants, gathering))
        if split := _mispaired(gathering, board, models, settings):
            for place, reason in split:
                gathering.drop(place, "tof", reason)
            continue
        estimate = adjust(gathering.views, board, models)
        misfit = _worst_misfit(estimate, settings.misfit)
        if misfit is None:
            break
        gathering.drop(*misfit)
    if wants := too_uncertain(estimate, settings):
        raise CalibrationError(_refusal("the boards do not suffice", wants, gathering))
    bias, notes = None, []
    if "tof" in models:
        bias, notes = depth_bias(gathering.views, board, estimate, settings.scale_error)
    return Calibrated(
        board,
        settings,
        estimate,
        tuple(gathering.views),
        tuple(gathering.skipped),
        bias,
        (*source.notes, *notes),
    )


def _mispaired(
    gathering: Gathering, board: Board, models: dict[str, Model], settings: CalibratingSettings
) -> list[tuple[int, str]]:
    """Views whose two images cannot be of one moment, and why: the board is not where the other pairs say."""
    pairs = [i for i, view in enumerate(gathering.views) if view.camera and view.tof]
    if not pairs:
        return []
    poses = {}
    for sensor, model in models.items():
        seen = [i for i, view in enumerate(gathering.views) if view.of(sensor)]
        alone = calibrate_alone([gathering.views[i].of(sensor) for i in seen], board, model)[1]
        poses[sensor] = dict(zip(seen, alone, strict=True))
    between = relative_poses(*([poses[sensor][i] for i in pairs] for sensor in SENSORS))
    return [
        (
            i,
            f"the board is {1e3 * off_m:.0f} mm and {np.degrees(off_rad):.1f} degrees from where it is in the camera's "
            "image: they are not of one moment",
        )
        for i, off_m, off_rad in zip(pairs, between.off_m, between.off_rad, strict=True)
        if off_m > settings.mispaired_m or off_rad > settings.mispaired_rad
    ][::-1]


def _worst_misfit(estimate: Estimate, times: float) -> tuple[int, str, str] | None:
    """The image that fits worst, if so many times worse than the median of its sensor's, and why it is dropped."""
    worst, found = times, None
    for sensor in SENSORS:
        noise = {view: fit.noise_px for (view, s), fit in estimate.fits.items() if s == sensor}
        usual = float(np.median(list(noise.values()))) if noise else 1.0
        for view, noise_px in noise.items():
            if noise_px > worst * usual:
                worst, found = noise_px / usual, (view, sensor, noise_px, usual)
    if found is None:
        return None
    view, sensor, noise_px, usual = found
    reason = (
        f"does not fit: {noise_px:.2f} px, others {usual:.2f} px. The board moved between the two exposures, is bent, "
        "or the images do not belong together"
    )
    return view, sensor, reason


def _refusal(what: str, wants: list[str], gathering: Gathering) -> str:
    lines = [f"{what}:", *(f"  - {want}" for want in wants)]
    reasons: dict[tuple[str, str], list[str]] = {}
    for skipped in gathering.skipped:
        reasons.setdefault((skipped.sensor, skipped.reason), []).append(skipped.name)
    if reasons:
        lines.append(f"{len(gathering.skipped)} images were not used:")
    for (sensor, reason), names in list(reasons.items())[:MOST_REASONS]:
        more = ", ..." if len(names) > MOST_NAMES else ""
        count = f"{len(names)} images, " if len(names) > 1 else ""
        lines.append(f"  - {WORDS[sensor]}, {count}{', '.join(names[:MOST_NAMES])}{more}: {reason}")
    if len(reasons) > MOST_REASONS:
        lines.append(f"  - and for {len(reasons) - MOST_REASONS} more reasons")
    return "\n".join(lines)
