"""quality.png: how well each image was measured: correlation, subsets, fixed region, uncertainty, latency."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from ..runs import Run
from .drawing import BLUE, ORANGE, SKY, Picture, line_of, plot_values, save, time_range_s
from .frames import Frames
from .panels import Panel, stack, stroke_words
from .series import Series

NAME = "quality.png"
FLOOR = 1e-2  # of the median: smaller uncertainties, that of the reference's own row, are not drawn on a logarithm


def draw(run: Run, methods: Sequence[Series], folder: Path) -> list[Picture]:
    """Write the figure; nothing if the run has neither images nor openings."""
    frames = Frames(run)
    panels: list[Panel] = []
    if len(frames.image_s):
        panels += [
            Panel(1.4, "correlation of the subsets that were found (ZNCC)", lambda axes: _draw_zncc(axes, frames)),
            Panel(1.1, "share of the reference's subsets that were found", lambda axes: _draw_found(axes, frames)),
        ]
    if run.frames.budgets:
        title = "residual of the fixed region after the motion was removed, RMS"
        panels.append(Panel(1.4, title, lambda axes: _draw_residuals(axes, run, frames)))
    if _any_known(methods, "u_mm"):
        title = "standard uncertainty of the opening (k = 1), as stated"
        panels.append(Panel(1.6, title, lambda axes: _draw_uncertainty(axes, methods)))
        panels.append(Panel(1.1, "subsets used in each measuring zone", lambda axes: _draw_subsets(axes, methods)))
    if _any_known(methods, "latency_ms"):
        title = "latency: from the arrival of the image to its opening"
        panels.append(Panel(1.4, title, lambda axes: _draw_latency(axes, methods)))
    if not panels:
        return []
    figure = stack(panels, time_range_s(frames.end_s))
    if methods:
        handles = [figure.axes[0].plot([], [], label=series.method, **line_of(series.method))[0] for series in methods]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(methods))
    caption = "How well each image was measured." + stroke_words(max(len(frames.image_s), *map(_length, methods), 0))
    titles = "; ".join(panel.title for panel in panels)
    return [save(figure, folder / NAME, caption, f"Quality of the measurement over time: {titles}.")]


def _length(series: Series) -> int:
    return len(series.time_s)


def _any_known(methods: Sequence[Series], name: str) -> bool:
    return any(np.isfinite(getattr(series, name)).any() for series in methods)


def _draw_zncc(axes: Axes, frames: Frames) -> None:
    plot_values(axes, frames.image_s, frames.of_images("zncc_median"), "median", color=BLUE, linewidth=1.2)
    low = {"color": ORANGE, "linestyle": "--", "linewidth": 1.2}
    plot_values(axes, frames.image_s, frames.of_images("zncc_low"), "5th percentile", **low)
    axes.set_ylabel("ZNCC")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)


def _draw_found(axes: Axes, frames: Frames) -> None:
    subsets = frames.of_images("subsets")
    share = np.divide(frames.of_images("found"), subsets, out=np.full(len(subsets), np.nan), where=subsets > 0)
    plot_values(axes, frames.image_s, 100 * share, color="0.25", linewidth=1.0)
    axes.set_ylim(0, 105)
    axes.set_ylabel("found [%]")


def _draw_residuals(axes: Axes, run: Run, frames: Frames) -> None:
    for method in dict.fromkeys(budget.method for budget in run.frames.budgets):
        mine = sorted((b for b in run.frames.budgets if b.method == method), key=lambda budget: budget.stamp_ns)
        stamps = np.array([budget.stamp_ns for budget in mine])
        residual = np.array([budget.residual_px for budget in mine])
        plot_values(axes, (stamps - frames.start_ns) * 1e-9, residual, **line_of(method))
    axes.set_ylim(bottom=0)
    axes.set_ylabel("residual [px]")


def _draw_uncertainty(axes: Axes, methods: Sequence[Series]) -> None:
    """On a logarithmic scale where the methods lie far apart; what is next to nothing, as at the reference, is left
    out there."""
    typical = []
    for series in methods:
        if np.isfinite(series.u_mm).any():
            typical.append(np.nanmedian(series.u_mm))
    logarithmic = len(typical) > 1 and max(typical) > 5 * min(typical) > 0
    for series in methods:
        u = np.where(series.u_mm > (FLOOR * min(typical) if logarithmic else 0), series.u_mm, np.nan)
        plot_values(axes, series.time_s, u, **line_of(series.method))
    if logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_ylabel("uncertainty [mm]")


def _draw_subsets(axes: Axes, methods: Sequence[Series]) -> None:
    sides = {"left": ("n_left", SKY, "-"), "right": ("n_right", ORANGE, "--")}
    first = methods[0]
    same = all(
        np.array_equal(getattr(series, name), getattr(first, name), equal_nan=True)
        for series in methods
        for name in ("n_left", "n_right")
    )
    for side, (name, color, style) in sides.items():
        for series in methods[:1] if same else methods:
            line = {"linewidth": 1.4, "linestyle": style}
            line["color"] = color if same else line_of(series.method)["color"]
            plot_values(axes, series.time_s, getattr(series, name), **line)
        axes.plot([], [], linestyle=style, color=color if same else "0.3", label=f"{side} zone")
    most = max(np.nanmax([0, *series.n_left, *series.n_right]) for series in methods)
    axes.set_ylim(0, 1.1 * most)
    axes.set_ylabel("subsets")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)


def _draw_latency(axes: Axes, methods: Sequence[Series]) -> None:
    for series in methods:
        plot_values(axes, series.time_s, series.latency_ms, **line_of(series.method))
    axes.set_ylim(bottom=0)
    axes.set_ylabel("latency [ms]")
