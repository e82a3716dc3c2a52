"""Figures of the calibration's report, and a picture of every board, as bytes to be put into the page."""

from __future__ import annotations

import io

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..report.drawing import BLACK, BLUE, DPI, GREEN, ORANGE, VERMILION, appearance, new_figure
from .calibrate import Calibrated
from .detection import Found
from .estimate import ImageFit
from .sufficiency import coverage, tilts
from .views import WORDS

Array = NDArray[np.float64]

COLOURS = {"camera": BLUE, "tof": ORANGE}
PICTURE_PX = 460  # width of a board's picture
TYPICAL_ARROW = 0.3  # length of an arrow of one standard deviation, part of a square
RED, YELLOW = (0, 60, 235), (0, 215, 255)  # BGR


def coverage_figure(result: Calibrated, sensor: str) -> bytes:
    """Where the boards were in a sensor's image, and where its residuals are."""
    model = result.estimate.layout.models[sensor]
    boards = [(i, view.of(sensor)) for i, view in enumerate(result.views) if view.of(sensor)]
    count = coverage([found for _, found in boards], model.width, model.height)
    with appearance():
        figure = new_figure(9.0, 3.5)
        axes = figure.subplots(1, 2)
        extent = (-0.5, model.width - 0.5, model.height - 0.5, -0.5)
        shown = np.where(count > 0, count, np.nan)
        picture = axes[0].imshow(shown, extent=extent, cmap="viridis", vmin=0, interpolation="nearest")
        figure.colorbar(picture, ax=axes[0], label="boards", shrink=0.8)
        axes[0].set_title(f"{WORDS[sensor]}: boards over the image")
        places = np.concatenate([found.corners_px for _, found in boards])
        errors = np.concatenate([result.estimate.fits[i, sensor].residuals_px for i, _ in boards])
        some = np.linspace(0, len(places) - 1, min(len(places), 1500)).astype(int)
        typical = float(np.sqrt(np.nanmean(errors**2)))
        arrows = axes[1].quiver(
            *places[some].T,
            *errors[some].T,
            angles="xy",
            scale_units="xy",
            scale=typical / (0.015 * model.width),
            width=0.0015,
            color=COLOURS[sensor],
        )
        axes[1].quiverkey(arrows, 0.82, 1.04, 3 * typical, f"{3 * typical:.2g} px", labelpos="E")
        axes[1].set_title("residuals, found less projected", loc="left")
        for ax in axes:
            ax.set(xlim=extent[:2], ylim=extent[2:], xlabel="x [px]", ylabel="y [px]", aspect="equal")
            ax.axvline(model.middle[0], color="0.6", linewidth=0.6)
            ax.axhline(model.middle[1], color="0.6", linewidth=0.6)
        return _png(figure)


def views_figure(result: Calibrated) -> bytes:
    """Residual of every board, and how the boards were tilted and how far away."""
    estimate = result.estimate
    with appearance():
        figure = new_figure(9.0, 3.2)
        left, right = figure.subplots(1, 2, width_ratios=(1.7, 1))
        sensors = list(estimate.layout.models)
        for offset, sensor in zip((-0.2, 0.2) if len(sensors) == 2 else (0.0,), sensors, strict=True):
            places = [i for i, view in enumerate(result.views) if view.of(sensor)]
            rms = [estimate.fits[i, sensor].rms_px for i in places]
            left.bar(np.array(places) + 1 + offset, rms, 0.38, color=COLOURS[sensor], label=WORDS[sensor])
        left.set(xlabel="board", ylabel="RMS reprojection error [px]", xlim=(0.3, len(result.views) + 0.7))
        left.legend(ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
        angles = np.degrees(tilts(estimate.poses))
        points = right.scatter(*angles.T, c=[t[2] for _, t in estimate.poses], cmap="viridis", s=18)
        figure.colorbar(points, ax=right, label="distance from the camera [m]")
        least = np.degrees(result.settings.least_tilt_rad)
        right.axvspan(-least, least, color="0.9", zorder=0)
        right.axhspan(-least, least, color="0.9", zorder=0)
        right.set(xlabel="tilt about the vertical axis [deg]", ylabel="about the horizontal axis [deg]")
        return _png(figure)


def bias_figure(result: Calibrated) -> bytes:
    """Range bias of every board over its range."""
    bias = result.bias
    assert bias is not None
    with appearance():
        figure = new_figure(6.5, 2.8)
        ax = figure.subplots()
        ax.errorbar(
            bias.range_m,
            1e3 * bias.board_bias_m,
            1e3 * bias.u_board_m,
            fmt="o",
            markersize=4,
            color=ORANGE,
            ecolor="0.5",
            capsize=2,
            label="board, with the noise of its pixels",
        )
        ax.axhline(1e3 * bias.bias_m, color=BLACK, linewidth=1, label="mean, with its uncertainty")
        ax.axhspan(1e3 * (bias.bias_m - bias.u_bias_m), 1e3 * (bias.bias_m + bias.u_bias_m), color=GREEN, alpha=0.2)
        ax.set(xlabel="range of the board [m]", ylabel="measured less true range [mm]")
        ax.legend()
        return _png(figure)


def histogram_figure(result: Calibrated) -> bytes:
    """Residuals of both sensors in x and y, beside the normal distribution that the uncertainties assume."""
    estimate = result.estimate
    with appearance():
        figure = new_figure(9.0, 2.6)
        axes = np.atleast_1d(figure.subplots(1, len(estimate.layout.models)))
        for ax, sensor in zip(axes, estimate.layout.models, strict=True):
            fits = [fit for (_, s), fit in estimate.fits.items() if s == sensor]
            _residual_histogram(ax, fits, COLOURS[sensor])
            ax.set_title(WORDS[sensor])
        axes[0].legend()
        return _png(figure)


def _residual_histogram(ax: Axes, fits: list[ImageFit], colour: str) -> None:
    normalised = np.concatenate([(fit.residuals_px / fit.noise_px).ravel() for fit in fits])
    normalised = normalised[np.isfinite(normalised)]
    edges = np.linspace(-5, 5, 51)
    ax.hist(normalised, edges, density=True, color=colour, alpha=0.6, label="residuals")
    ax.plot(edges, np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi), color=VERMILION, linewidth=1, label="normal")
    ax.set(xlabel="residual over the noise of its image", yticks=[])


def board_picture(image: NDArray, found: Found, fit: ImageFit) -> tuple[bytes, float]:
    """JPEG of a board with an arrow for each corner's residual, a cross for one left out; and how many times the arrows
    are enlarged."""
    low, high = np.percentile(image, [0.5, 99.5])
    grey = np.clip((image - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
    margin = 2 * found.spacing_px
    first = np.maximum(np.floor(found.corners_px.min(axis=0) - margin), 0).astype(int)
    last = np.minimum(np.ceil(found.corners_px.max(axis=0) + margin), np.array(grey.shape[::-1]) - 1).astype(int)
    crop = grey[first[1] : last[1] + 1, first[0] : last[0] + 1]
    scale = PICTURE_PX / crop.shape[1]
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    canvas = cv2.cvtColor(cv2.resize(crop, None, fx=scale, fy=scale, interpolation=how), cv2.COLOR_GRAY2BGR)
    enlarged = _round(TYPICAL_ARROW * found.spacing_px / fit.noise_px)
    starts = (found.corners_px - first + 0.5) * scale - 0.5
    for start, residual in zip(starts, fit.residuals_px, strict=True):
        if np.isfinite(residual).all():
            _arrow(canvas, start, start + enlarged * scale * residual)
        else:
            cv2.drawMarker(canvas, tuple(np.rint(start).astype(int).tolist()), YELLOW, cv2.MARKER_TILTED_CROSS, 12, 2)
    return cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes(), enlarged


def _arrow(canvas: NDArray[np.uint8], start: Array, end: Array) -> None:
    """With ends to a sixteenth of a pixel."""
    a, b = (tuple(np.rint(16 * point).astype(int).tolist()) for point in (start, end))
    cv2.line(canvas, a, b, RED, 2, cv2.LINE_AA, 4)
    cv2.circle(canvas, a, 32, RED, -1, cv2.LINE_AA, 4)


def _round(value: float) -> float:
    """To one of 1, 2, 5 times a power of ten, downwards."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()
