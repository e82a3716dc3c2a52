"""How all figures of a report look: colours and marks of the methods, long histories, files."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

DPI = 130
STROKES = 1500  # a history of more frames is drawn as this many strokes, about one for each pixel of the figure's width

# Okabe and Ito's colours, told apart with every kind of colour vision; line styles tell them apart in grey print.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
LINES = {
    "h_pose": {"color": BLUE, "linestyle": "-"},
    "h_3d": {"color": VERMILION, "linestyle": "--"},
    "h_2d": {"color": GREEN, "linestyle": "-."},
    "pc_3d": {"color": PURPLE, "linestyle": ":", "linewidth": 1.7},
}
OTHER_LINE = {"color": ORANGE, "linestyle": (0, (5, 1, 1, 1, 1, 1))}
TRUTH_LINE = {"color": BLACK, "alpha": 0.35, "linewidth": 4.0, "solid_capstyle": "butt"}


@dataclass(frozen=True)
class Picture:
    """A figure that was written: its file, and what the page says below it and in its place."""

    path: Path
    caption: str
    alt: str


def appearance() -> AbstractContextManager[None]:
    """Matplotlib's own defaults with this report's sizes, whatever the user's configuration says."""
    ours = {
        "font.size": 9,
        "axes.titlesize": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.formatter.useoffset": False,
        "legend.fontsize": 8,
        "legend.frameon": False,
        "figure.facecolor": "white",
    }
    defaults = {key: value for key, value in mpl.rcParamsDefault.items() if key != "backend"}
    return mpl.rc_context({**defaults, **ours})


def method_order(methods: Any) -> list[str]:
    """The methods in the order of the legend, any unknown ones last."""
    return [m for m in LINES if m in methods] + sorted(set(methods) - set(LINES))


def line_of(method: str) -> dict[str, Any]:
    return {"linewidth": 1.2, **LINES.get(method, OTHER_LINE)}


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure that belongs to nobody else."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path, caption: str, alt: str) -> Picture:
    figure.savefig(path, dpi=DPI)
    return Picture(path, caption, alt)


def frames_per_stroke(count: int) -> int:
    return max(1, -(-count // STROKES))


def envelope(time_s: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """(m,) times, lowest and highest value of each stroke; NaN where no frame of a stroke has a value.

    As long as the frames are few, each is its own stroke and nothing changes.
    """
    size = frames_per_stroke(len(time_s))
    if size == 1:
        return time_s, low, high
    padding = -len(time_s) % size

    def strokes(values: Array, end: float) -> Array:
        return np.append(values, np.full(padding, end)).reshape(-1, size)

    lows, highs = strokes(low, np.nan), strokes(high, np.nan)
    lowest = np.where(np.isnan(lows), np.inf, lows).min(axis=1)
    highest = np.where(np.isnan(highs), -np.inf, highs).max(axis=1)
    return (
        strokes(time_s, time_s[-1]).mean(axis=1),
        np.where(np.isinf(lowest), np.nan, lowest),
        np.where(np.isinf(highest), np.nan, highest),
    )


def plot_values(axes: Axes, time_s: Array, values: Array, label: str = "", **line: Any) -> None:
    """A history as a line that breaks where values are NaN; a value alone between two breaks becomes a dot."""
    time_s, low, high = envelope(time_s, values, values)
    if low is not high:
        time_s, low = np.repeat(time_s, 2), np.column_stack([low, high]).ravel()
    axes.plot(time_s, low, label=label or None, **line)
    known = np.append(np.append(False, np.isfinite(low)), False)
    alone = known[1:-1] & ~known[:-2] & ~known[2:]
    if alone.any():
        axes.plot(time_s[alone], low[alone], ".", color=line.get("color"), markersize=4)


def plot_band(axes: Axes, time_s: Array, low: Array, high: Array, color: str) -> None:
    axes.fill_between(*envelope(time_s, low, high), color=color, alpha=0.2, linewidth=0)
