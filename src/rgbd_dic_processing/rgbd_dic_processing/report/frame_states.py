"""Marks on a time axis: which frames are not valid, by which method, and why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ..core.status import FrameStatus
from .drawing import STROKES, line_of
from .series import STATUS_WORDS, Series


def states(methods: Sequence[Series], with_valid: bool) -> list[FrameStatus]:
    """The statuses that occur, in their own order."""
    found = sorted({int(status) for series in methods for status in series.status})
    return [FrameStatus(status) for status in found if with_valid or status != FrameStatus.OK]


def draw_states(axes: Axes, methods: Sequence[Series], with_valid: bool) -> None:
    """One row for each status with its count of frames; in a row one lane for each method, in its colour.

    A mark is at least one stroke wide, so that a single frame of a long run is still seen.
    """
    rows = states(methods, with_valid)
    end = max((series.time_s[-1] for series in methods), default=0.0)
    frames = max((len(series.time_s) for series in methods), default=1)
    thickness = float(np.clip(300 / frames, 1.0, 4.0))
    lane = 0.8 / max(len(methods), 1)
    for row, status in enumerate(rows):
        for place, series in enumerate(methods):
            times = series.time_s[series.status == status]
            if len(times) > STROKES:
                width = end / STROKES
                times = (np.unique((times / width).astype(int)) + 0.5) * width
            middle = row - 0.4 + (place + 0.5) * lane
            color = line_of(series.method)["color"]
            axes.vlines(times, middle - lane * 0.45, middle + lane * 0.45, color=color, linewidth=thickness)
    axes.set_yticks(range(len(rows)), [_label(status, methods) for status in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def _label(status: FrameStatus, methods: Sequence[Series]) -> str:
    counts = [int(np.sum(series.status == status)) for series in methods]
    span = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    return f"{STATUS_WORDS.get(status, status.name)}: {span}"
