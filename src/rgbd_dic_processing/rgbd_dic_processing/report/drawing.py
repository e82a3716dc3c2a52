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
TIME_LABEL = "time since the first frame [s]"
BROKEN = 5  # missing frames in succession that a line does not bridge
STROKES = 1000  # a longer history is drawn as so many strokes, about one for each pixel of its width

# Okabe and Ito's colours are told apart with every kind of colour vision, the line styles also in grey print.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "0.55"
LINES = {
    "h_pose": {"color": BLUE, "linestyle": "-"},
    "h_joint": {"color": SKY, "linestyle": (0, (5, 1))},
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


def time_range_s(end_s: float) -> tuple[float, float]:
    """What a time axis shows of a run of this length."""
    return (-0.01 * end_s, 1.01 * end_s) if end_s > 0 else (-0.5, 0.5)


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


def with_gaps(time_s: Array, *values: Array) -> tuple[Array, ...]:
    """Times and values (n,) with NaN where at least `BROKEN` frames in succession are missing, one for each."""
    steps = np.diff(time_s)
    period = np.median(steps) if len(steps) else 0.0
    missing = np.where(steps > (BROKEN + 0.5) * period, steps / max(period, 1e-9) - 1, 0)
    counts = np.minimum(np.round(missing), len(time_s)).astype(int)  # a very long silence needs no more than that
    if not counts.any():
        return time_s, *values
    places = np.repeat(np.arange(1, len(time_s)), counts)
    inserted = np.concatenate(
        [before + step * np.arange(1, n + 1) / (n + 1) for before, step, n in zip(time_s, steps, counts, strict=False)]
    )
    return np.insert(time_s, places, inserted), *(np.insert(each, places, np.nan) for each in values)


def plot_values(axes: Axes, time_s: Array, values: Array, label: str = "", **line: Any) -> None:
    """A history as a line that breaks where values are NaN or frames are missing; a value alone becomes a dot."""
    time_s, values = with_gaps(time_s, values)
    drawn_s, low, high = envelope(time_s, values, values)
    if len(drawn_s) < len(time_s):
        drawn_s, low = np.repeat(drawn_s, 2), np.column_stack([low, high]).ravel()
        axes.plot([], [], label=label or None, **line)
        axes.plot(
            drawn_s,
            low,
            color=line.get("color"),
            alpha=line.get("alpha", 0.75),
            linewidth=line.get("linewidth", 1.2) / 2,
        )
    else:
        axes.plot(drawn_s, low, label=label or None, **line)
    alone = _alone(low)
    axes.plot(drawn_s[alone], low[alone], ".", color=line.get("color"), markersize=4)


def plot_band(axes: Axes, time_s: Array, low: Array, high: Array, color: str, outlined: bool = False) -> None:
    """A band that breaks where its limits are NaN or frames are missing; those of a frame alone become a bar."""
    time_s, low, high = with_gaps(time_s, low, high)
    drawn_s, low, high = envelope(time_s, low, high)
    axes.fill_between(drawn_s, low, high, color=color, alpha=0.2, linewidth=0)
    alone = _alone(low)
    axes.vlines(drawn_s[alone], low[alone], high[alone], color=color, alpha=0.3, linewidth=3)
    if outlined:
        for limit in (low, high):
            axes.plot(drawn_s, limit, color="0.2", linewidth=0.5, zorder=3)


def _alone(values: Array) -> NDArray[np.bool_]:
    known = np.concatenate([[False], np.isfinite(values), [False]])
    return known[1:-1] & ~known[:-2] & ~known[2:]
