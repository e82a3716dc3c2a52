"""tof.png: which ToF frame each image was paired with, and the plane of each ToF frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ..runs import Run
from .drawing import BLUE, ORANGE, Picture, plot_values, save, time_range_s
from .frames import Frames
from .panels import Panel, stack, stroke_words

Array = NDArray[np.float64]

NAME = "tof.png"
BINS = 40


def draw(run: Run, folder: Path) -> list[Picture]:
    """Write the figure; nothing if the run kept nothing of its ToF frames."""
    frames, panels = Frames(run), []
    offset_ms = frames.of_images("depth_offset_s") * 1e3
    if np.isfinite(offset_ms).any():
        title = "stamp of the image less that of its ToF frame (negative: ToF later)"
        panels.append(Panel(1.6, title, lambda axes: _draw_offset(axes, frames.image_s, offset_ms)))
    if len(frames.plane_s):
        panels += [
            Panel(1.4, "residual of the ToF points on the plane, RMS", lambda axes: _draw_residual(axes, frames)),
            Panel(1.4, "ToF points of each frame", lambda axes: _draw_points(axes, frames)),
            Panel(1.1, "distance of the panel's plane from the camera", lambda axes: _draw_distance(axes, frames)),
            Panel(1.1, "angle between the camera's axis and the panel's normal", lambda axes: _draw_tilt(axes, frames)),
        ]
    if not panels:
        return []
    figure = stack(panels, time_range_s(frames.end_s))
    caption = (
        "Pairing of the images with ToF frames, and the plane of each ToF frame. At the right, how often each offset "
        "occurs."
    )
    caption += stroke_words(len(frames.image_s))
    titles = "; ".join(panel.title for panel in panels)
    return [save(figure, folder / NAME, caption, f"ToF frames over time: {titles}.")]


def _draw_offset(axes: Axes, time_s: Array, offset_ms: Array) -> None:
    plot_values(axes, time_s, offset_ms, color="0.25", linestyle="none", marker=".", markersize=3)
    axes.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    axes.set_ylabel("offset [ms]")
    beside = axes.inset_axes((1.02, 0, 0.13, 1), sharey=axes)
    beside.hist(offset_ms[np.isfinite(offset_ms)], BINS, orientation="horizontal", color="0.45")
    beside.tick_params(labelleft=False)
    beside.xaxis.tick_top()
    beside.spines[["bottom", "top"]].set_visible(False)
    beside.set_title("images", loc="left")


def _draw_residual(axes: Axes, frames: Frames) -> None:
    _draw_above_zero(axes, frames.plane_s, frames.of_planes("residual_rms_m") * 1e3)
    axes.set_ylabel("residual [mm]")


def _draw_points(axes: Axes, frames: Frames) -> None:
    points, inliers = frames.of_planes("points"), frames.of_planes("inliers")
    plot_values(axes, frames.plane_s, points, "in the panel region", color=BLUE, linewidth=1.2)
    plot_values(axes, frames.plane_s, inliers, "on the plane", color=ORANGE, linestyle="--", linewidth=1.2)
    axes.set_ylim(0, 1.1 * max(points.max(), 1))
    axes.set_ylabel("points")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)


def _draw_distance(axes: Axes, frames: Frames) -> None:
    plot_values(axes, frames.plane_s, frames.of_planes("distance_m") * 1e3, color="0.25", linewidth=1.0)
    axes.set_ylabel("distance [mm]")


def _draw_tilt(axes: Axes, frames: Frames) -> None:
    _draw_above_zero(axes, frames.plane_s, np.degrees(frames.of_planes("tilt_rad")))
    axes.set_ylabel("angle [degrees]")


def _draw_above_zero(axes: Axes, time_s: Array, values: Array) -> None:
    plot_values(axes, time_s, values, color="0.25", linewidth=1.0)
    axes.set_ylim(0, 1.15 * np.nanmax(values) if np.nanmax(values, initial=0) > 0 else 1)
