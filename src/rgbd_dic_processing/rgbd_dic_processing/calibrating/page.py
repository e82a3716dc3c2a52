"""calibration.html: one page with all that a calibration rests on, which needs no other file."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from . import figures
from .calibrate import Calibrated
from .sufficiency import tilts
from .summary import rows
from .views import SENSORS, WORDS

TEMPLATE = "page.html.j2"


def write_page(
    path: Path,
    result: Calibrated,
    inputs: dict[str, str],
    versions: dict[str, str],
    advance: Callable[[], None] | None = None,
) -> Path:
    """Draw all figures and write the page.

    Args:
        inputs: what was calibrated from, in words; of absolute paths the last part is shown.
        advance: called after each board's picture.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    sensors = list(result.estimate.layout.models)
    text = environment.get_template(TEMPLATE).render(
        name=path.resolve().parent.name,
        inputs={key: _without_folder(value) for key, value in inputs.items()},
        board=result.board.words,
        notes=result.notes,
        estimates=rows(result),
        fits=[_fit(result, sensor) for sensor in sensors],
        range_noise_mm="" if result.bias is None else f"{1e3 * result.bias.noise_m:.1f}",
        figures=_figures(result),
        boards=[_board(result, index, advance) for index in range(len(result.views))],
        skipped=[(s.name, WORDS[s.sensor], s.reason) for s in result.skipped],
        settings=result.settings.as_dict(),
        versions=versions,
    )
    path.write_text(text, encoding="utf-8")
    return path


def _figures(result: Calibrated) -> list[tuple[bytes, str]]:
    """PNG and caption."""
    drawn = [
        (
            figures.coverage_figure(result, sensor),
            f"{WORDS[sensor]}. Left: how many boards cover each part of the image. Right: residuals of all corners, "
            "enlarged. They should look like noise; arrows that point alike in one part of the image mean that the "
            "model of the lens does not fit there.",
        )
        for sensor in result.estimate.layout.models
    ]
    drawn.append(
        (
            figures.views_figure(result),
            "Left: RMS reprojection error of every board, numbered as below. Right: its tilt; there must be boards on "
            "all four sides of the grey bands.",
        )
    )
    drawn.append(
        (
            figures.histogram_figure(result),
            "Residuals of all corners, each over the noise of its image. Far tails mean wrong corners.",
        )
    )
    if result.bias is not None:
        drawn.append(
            (
                figures.bias_figure(result),
                "What the ToF sensor measured along its rays less the range of the board's plane, on light parts of "
                "each board. The uncertainty of the mean (band) holds that of the calibration, which all boards share.",
            )
        )
    return drawn


def _fit(result: Calibrated, sensor: str) -> dict[str, Any]:
    fits = [fit for (_, s), fit in result.estimate.fits.items() if s == sensor]
    errors = np.concatenate([fit.residuals_px for fit in fits])
    used = np.isfinite(errors[:, 0])
    return {
        "sensor": WORDS[sensor],
        "boards": len(fits),
        "corners": int(used.sum()),
        "left_out": int((~used).sum()),
        "rms": f"{np.sqrt(np.mean(np.sum(errors[used] ** 2, axis=1))):.4f}",
        "noise": f"{np.median([fit.noise_px for fit in fits]):.4f}",
        "worst": f"{max(fit.rms_px for fit in fits):.4f}",
    }


def _board(result: Calibrated, index: int, advance: Callable[[], None] | None) -> dict[str, Any]:
    view, (R, t) = result.views[index], result.estimate.poses[index]
    about_vertical, about_horizontal = np.degrees(tilts([(R, t)])[0])
    pictures = []
    for sensor in SENSORS:
        if view.of(sensor):
            fit = result.estimate.fits[index, sensor]
            data, enlarged = figures.board_picture(view.images[sensor], view.of(sensor), fit)
            words = f"{WORDS[sensor]}: {fit.rms_px:.3f} px RMS, arrows {enlarged:g} times"
            pictures.append({"data": data, "words": words})
    if advance is not None:
        advance()
    place = f"{np.linalg.norm(t):.2f} m away, tilted by {about_vertical:.0f}° about the vertical axis and "
    return {
        "number": index + 1,
        "name": view.name,
        "place": place + f"{about_horizontal:.0f}° about the horizontal one",
        "pictures": pictures,
    }


def _without_folder(value: str) -> str:
    path = PurePath(value)
    return path.name if path.is_absolute() else value
