"""validity.png: which frames are valid, by which method, and if not, why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ..core.spells import gaps_of, spells_of
from ..core.status import FrameStatus
from .drawing import STROKES, TIME_LABEL, Picture, line_of, new_figure, save, time_range_s
from .series import STATUS_WORDS, Series

NAME = "validity.png"
NO_IMAGE = "no image came"


def draw(methods: Sequence[Series], folder: Path) -> list[Picture]:
    """Write the figure; nothing if the run has no openings.

    One row for each state that occurs, in it one lane for each method: the place tells the state, not the colour.
    """
    if not methods:
        return []
    statuses = [FrameStatus(value) for value in sorted({int(s) for series in methods for s in series.status})]
    gaps = gaps_of(max((series.time_s for series in methods), key=len))
    rows = len(statuses) + bool(gaps)
    figure = new_figure(9.0, 0.9 + (0.1 * len(methods) + 0.15) * rows)
    axes = figure.subplots()
    thinnest = max(series.time_s[-1] for series in methods) / STROKES * 2
    for row, status in enumerate(statuses):
        _draw_lanes(axes, row, status, methods, thinnest)
    names = [_label(status, methods) for status in statuses]
    if gaps:
        _bars(axes, gaps, rows - 1, 0.8, thinnest, "0.6")
        times = f"{len(gaps)} times, " if len(gaps) > 1 else ""
        names.append(f"{NO_IMAGE}: {times}{sum(end - begin for begin, end in gaps):.2f} s")
    axes.set_yticks(range(rows), names)
    axes.set_ylim(rows - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.hlines(np.arange(rows - 1) + 0.5, 0, 1, transform=axes.get_yaxis_transform(), color="0.85", linewidth=0.6)
    axes.set_xlabel(TIME_LABEL)
    axes.set_xlim(*time_range_s(max(series.time_s[-1] for series in methods)))
    handles = [axes.barh(0, 0, color=line_of(series.method)["color"], label=series.method) for series in methods]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(methods))
    caption = (
        "Frames by state, from top to bottom in the order of the legend within each row. The number is that of the "
        "frames, of the methods with the fewest and the most."
    )
    alt = f"Strips over time of the frames of each method by state: {'; '.join(names)}."
    return [save(figure, folder / NAME, caption, alt)]


def _draw_lanes(axes: Axes, row: int, status: FrameStatus, methods: Sequence[Series], thinnest: float) -> None:
    lane = 0.8 / len(methods)
    for place, series in enumerate(methods):
        spells = spells_of(series.time_s, series.status)
        spans = [(spell.begin_s, spell.end_s) for spell in spells if spell.state == status]
        middle = row - 0.4 + (place + 0.5) * lane
        _bars(axes, spans, middle, 0.9 * lane, thinnest, line_of(series.method)["color"])


def _bars(
    axes: Axes, spans: Sequence[tuple[float, float]], middle: float, height: float, thinnest: float, color: str
) -> None:
    """Spans of time as bars, none thinner than can be seen."""
    widths = [max(end - begin, thinnest) for begin, end in spans]
    lefts = [(begin + end - width) / 2 for (begin, end), width in zip(spans, widths, strict=True)]
    axes.broken_barh(list(zip(lefts, widths, strict=True)), (middle - height / 2, height), color=color, linewidth=0)


def _label(status: FrameStatus, methods: Sequence[Series]) -> str:
    counts = [int(np.sum(series.status == status)) for series in methods]
    span = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    return f"{STATUS_WORDS.get(status, status.name)}: {span}"
