"""Figures of several panels over one time axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .drawing import TIME_LABEL, frames_per_stroke, new_figure


class Panel(NamedTuple):
    """What is drawn into one panel of a height [in]; nothing if there is nothing to draw."""

    height: float
    title: str
    draw: Callable[[Axes], None]


def stack(panels: Sequence[Panel], time_range_s: tuple[float, float]) -> Figure:
    """The panels below each other."""
    heights = [panel.height for panel in panels]
    figure = new_figure(9.0, 1.0 + sum(heights) + 0.25 * len(panels))
    all_axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for axes, panel in zip(all_axes, panels, strict=True):
        axes.set_title(panel.title, loc="left")
        panel.draw(axes)
    all_axes[-1].set_xlabel(TIME_LABEL)
    all_axes[0].set_xlim(*time_range_s)
    return figure


def stroke_words(count: int) -> str:
    """What a caption says of long histories."""
    size = frames_per_stroke(count)
    return f" Each stroke spans the lowest to the highest value of {size} frames in succession." if size > 1 else ""
