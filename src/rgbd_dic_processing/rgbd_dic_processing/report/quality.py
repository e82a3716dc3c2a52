"""quality.png: what each frame rests on: validity, ToF pairing, uncertainty, subsets, latency."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from .drawing import (
    ORANGE,
    SKY,
    Picture,
    frames_per_stroke,
    line_of,
    new_figure,
    plot_values,
    save,
)
from .frame_states import draw_states, states
from .history import TIME_LABEL
from .series import Series

NAME = "quality.png"


def draw(methods: Sequence[Series], folder: Path) -> list[Picture]:
    """Write the figure; nothing if the run has no openings."""
    if not methods:
        return []
    panels: list[tuple[float, str, Callable[[Axes, Sequence[Series]], None]]] = [
        (
            0.25 + 0.28 * len(states(methods, with_valid=True)),
            "frames by state, for each method",
            _draw_states,
        )
    ]
    if _any_known(methods, "offset_ms"):
        panels.append((1.4, "stamp of the image less that of its ToF frame (negative: ToF later)", _draw_offset))
    if _any_known(methods, "u_mm"):
        panels.append((1.6, "standard uncertainty of the opening (k = 1), as stated", _draw_uncertainty))
        panels.append((1.4, "subsets used in each measuring zone", _draw_subsets))
    if _any_known(methods, "latency_ms"):
        panels.append((1.4, "latency: from the arrival of the image to its opening", _draw_latency))
    figure = new_figure(9.0, 1.0 + sum(height for height, _, _ in panels) + 0.25 * len(panels))
    all_axes = figure.subplots(
        len(panels), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": [p[0] for p in panels]}
    )[:, 0]
    for axes, (_, title, draw_panel) in zip(all_axes, panels, strict=True):
        axes.set_title(title, loc="left")
        draw_panel(axes, methods)
    all_axes[-1].set_xlabel(TIME_LABEL)
    end = max(series.time_s[-1] for series in methods)
    all_axes[0].set_xlim((-0.01 * end, 1.01 * end) if end > 0 else (-0.5, 0.5))
    handles = [all_axes[0].plot([], [], label=series.method, **line_of(series.method))[0] for series in methods]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(methods))
    caption = "What the measurement of each frame rests on."
    size = frames_per_stroke(max(len(series.time_s) for series in methods))
    if size > 1:
        caption += f" Each stroke spans the lowest to the highest value of {size} frames in succession."
    titles = "; ".join(title for _, title, _ in panels)
    return [save(figure, folder / NAME, caption, f"Quality of the measurement over time: {titles}.")]


def _any_known(methods: Sequence[Series], name: str) -> bool:
    return any(np.isfinite(getattr(series, name)).any() for series in methods)


def _draw_states(axes: Axes, methods: Sequence[Series]) -> None:
    draw_states(axes, methods, with_valid=True)


def _draw_offset(axes: Axes, methods: Sequence[Series]) -> None:
    """The pairing is made once for all methods; one that waits longer for its frame knows no less."""
    longest = max(methods, key=lambda series: np.isfinite(series.offset_ms).sum())
    plot_values(axes, longest.time_s, longest.offset_ms, color="0.25", linewidth=0.8)
    axes.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    axes.set_ylabel("offset [ms]")


def _draw_uncertainty(axes: Axes, methods: Sequence[Series]) -> None:
    """On a logarithmic scale where the methods lie far apart; zero, which the reference has, is left out."""
    typical = []
    for series in methods:
        u = np.where(series.u_mm > 0, series.u_mm, np.nan)
        plot_values(axes, series.time_s, u, **line_of(series.method))
        if np.isfinite(u).any():
            typical.append(np.nanmedian(u))
    if len(typical) > 1 and max(typical) > 5 * min(typical):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
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
