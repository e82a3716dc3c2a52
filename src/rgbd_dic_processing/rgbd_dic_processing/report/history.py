"""history.png: the opening over time, its uncertainty and the truth; the error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from .drawing import (
    TIME_LABEL,
    TRUTH_LINE,
    Picture,
    line_of,
    new_figure,
    plot_band,
    plot_values,
    save,
    time_range_s,
)
from .panels import stroke_words
from .series import Series
from .summary import summarise

NAME = "history.png"


def draw(methods: Sequence[Series], folder: Path) -> list[Picture]:
    """Write the figure; nothing if the run has no openings."""
    if not methods:
        return []
    compared = [series for series in methods if np.isfinite(series.error_mm).any()]
    rms_mm = {line.method: line.rms_mm for line in summarise(methods)}
    heights = [3.2] + [1.25] * len(compared)
    figure = new_figure(9.0, 0.6 + sum(heights) + 0.2 * len(heights))
    panels = figure.subplots(len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    _draw_openings(panels[0], methods)
    for axes, series in zip(panels[1:], compared, strict=True):
        _draw_error(axes, series, rms_mm[series.method])
    panels[-1].set_xlabel(TIME_LABEL)
    panels[0].set_xlim(*time_range_s(max(series.time_s[-1] for series in methods)))
    return [save(figure, folder / NAME, _caption(methods, compared), _alt(methods, compared))]


def _draw_openings(axes: Axes, methods: Sequence[Series]) -> None:
    known = next((series for series in methods if np.isfinite(series.truth_mm).any()), None)
    if known is not None:
        plot_values(axes, known.time_s, known.truth_mm, "truth", **TRUTH_LINE)
    for series in reversed(methods):  # the first method on top
        line = line_of(series.method)
        low, high = series.opening_mm - 2 * series.u_mm, series.opening_mm + 2 * series.u_mm
        plot_band(axes, series.time_s, low, high, line["color"])
        plot_values(axes, series.time_s, series.opening_mm, series.method, **line)
    if not any(series.valid.any() for series in methods):
        axes.text(0.02, 0.95, "no frame is valid", transform=axes.transAxes, va="top")
    axes.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    axes.set_ylabel("opening since the reference [mm]")
    axes.set_ylim(*_opening_range(methods))
    lines, names = axes.get_legend_handles_labels()
    truths = [i for i, name in enumerate(names) if name == "truth"]
    order = truths + [names.index(series.method) for series in methods]
    axes.legend(
        [lines[i] for i in order],
        [names[i] for i in order],
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=6,
    )


def _opening_range(methods: Sequence[Series]) -> tuple[float, float]:
    """All openings and truths [mm] and nearly all bands: one huge uncertainty must not flatten the rest."""
    values = np.concatenate([np.zeros(1)] + [v for series in methods for v in (series.opening_mm, series.truth_mm)])
    bands = np.concatenate([2 * series.u_mm for series in methods])
    bands = bands[np.isfinite(bands)]
    low, high = np.nanmin(values), np.nanmax(values)
    margin = max(np.percentile(bands, 95) if len(bands) else 0.0, 0.05 * (high - low), 1e-3)
    return low - margin, high + margin


def _draw_error(axes: Axes, series: Series, rms_mm: float) -> None:
    line, error = line_of(series.method), series.error_mm
    compared = np.isfinite(error)
    plot_band(axes, series.time_s, -2 * series.u_mm, 2 * series.u_mm, line["color"], outlined=True)
    plot_values(axes, series.time_s, error, **line)
    axes.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    reach = 1.15 * max(np.max(np.abs(error[compared])), np.percentile(2 * series.u_mm[compared], 95), 1e-6)
    axes.set_ylim(-reach, reach)
    axes.set_ylabel("error [mm]")
    rms = f", RMS {rms_mm:.4f} mm" if np.isfinite(rms_mm) else ""
    axes.set_title(f"{series.method}: measured less true opening{rms}", loc="left")


def _caption(methods: Sequence[Series], compared: Sequence[Series]) -> str:
    text = (
        "Crack opening since the reference image [mm]. The shaded bands are plus and minus two standard "
        "uncertainties (k = 2) as the measurement states them."
    )
    if compared:
        text += " Below, the error of each method on a scale of its own, over its stated band around zero."
    return text + stroke_words(max(len(series.time_s) for series in methods))


def _alt(methods: Sequence[Series], compared: Sequence[Series]) -> str:
    names = ", ".join(series.method for series in methods)
    return f"Crack opening in millimetres over time by {names}" + (
        ", with the truth and the error of each method." if compared else "."
    )
