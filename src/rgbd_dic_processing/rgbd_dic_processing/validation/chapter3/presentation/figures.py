"""Figures 3.12 to 3.15 redrawn from a run, and what goes beyond the thesis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from ....report.drawing import BLACK, BLUE, GREEN, ORANGE, VERMILION, Picture, appearance, new_figure, save
from ..chapter import Chapter3
from ..oblique import CRACK_MM, SERIES

Array = NDArray[np.float64]

# Image and subsets: how each kind is drawn, everywhere alike; told apart in grey print by marker and line.
KINDS = {
    ("disks", "affine"): ("disks, affine subsets", {"color": VERMILION, "marker": "^", "linestyle": ":"}),
    ("disks", "8 bit"): ("disks", {"color": ORANGE, "marker": "s", "linestyle": "--"}),
    ("blobs", "8 bit"): ("band-limited", {"color": BLUE, "marker": "o", "linestyle": "-"}),
}
CALIBRATIONS = {
    "printed": ("K of Eq. 3.1", {"color": VERMILION, "marker": "^", "linestyle": ":"}),
    "calibrated": ("calibrated K", {"color": ORANGE, "marker": "s", "linestyle": "--"}),
    "8 bit": ("true K", {"color": BLUE, "marker": "o", "linestyle": "-"}),
}
METHOD_MARKS = {
    "h_3d": {"color": VERMILION, "marker": "s"},
    "h_2d": {"color": GREEN, "marker": "^"},
    "h_pose": {"color": BLUE, "marker": "o"},
}
REFERENCE = 0  # that the figures of the thesis show
METHOD = "h_3d"


def draw(data: Chapter3, folder: Path) -> list[Picture]:
    """Write every figure that the run has the numbers for."""
    with appearance():
        pictures = []
        if len(data.series("yaw")) > 2:
            pictures += [_averages(data, folder), _rms(data, folder)]
        if len(data.scope.growing) > 1:
            pictures.append(_cracks(data, folder))
        return [*pictures, _oblique(data, folder)]


def _averages(data: Chapter3, folder: Path) -> Picture:
    """Figure 3.13."""
    figure = new_figure(9.0, 3.2)
    axes = figure.subplots(1, 3, sharey=True)
    for ax, series in zip(axes, ("yaw", "pitch", "roll"), strict=True):
        shots = data.series(series)
        for (pattern, variant), (label, style) in KINDS.items():
            numbers = tuple(shot.number for shot in shots)
            averages = data.values(pattern, variant, METHOD, references=(REFERENCE,), shots=numbers)[0]
            ax.plot([shot.angle_deg for shot in shots], averages, label=label, markersize=4, linewidth=1, **style)
        ax.axhline(10, color=BLACK, linewidth=0.8, alpha=0.5)
        ax.set_xlabel(f"{series} angle [degrees]")
        ax.set_xticks([-15, -9, -3, 3, 9, 15])
    axes[0].set_ylabel("average [mm]")
    _legend(figure, axes[0])
    caption = (
        f"Figure 3.13: average displacement [mm] of the moving part for each image with a crack of 10 mm, "
        f"against the angle that its series varies ({METHOD}, reference {REFERENCE}; the line is the truth)."
    )
    return save(figure, folder / "chapter3_averages.png", caption, "Averages against yaw, pitch and roll.")


def _rms(data: Chapter3, folder: Path) -> Picture:
    """Figure 3.14."""
    figure = new_figure(9.0, 3.2)
    axes = figure.subplots(1, 3, sharey=True)
    shots = data.series("pitch")
    numbers = tuple(shot.number for shot in shots)
    angles = [shot.angle_deg for shot in shots]
    for ax, ((pattern, variant), (label, style)) in zip(axes, KINDS.items(), strict=True):
        for quantity, words, filled in (("rms_error", "RMS error", True), ("std_dev", "standard deviation", False)):
            values = data.values(pattern, variant, METHOD, quantity, (REFERENCE,), numbers)[0]
            face = style["color"] if filled else "white"
            line = "-" if filled else "--"
            ax.plot(
                angles,
                values,
                label=words,
                color=style["color"],
                marker=style["marker"],
                markersize=5,
                markerfacecolor=face,
                linestyle=line,
                linewidth=1,
            )
        ax.set_title(label, loc="left")
        ax.set_xlabel("pitch angle [degrees]")
        ax.set_xticks([-15, -9, -3, 3, 9, 15])
        ax.legend()
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("in one image [mm]")
    caption = (
        f"Figure 3.14: RMS error (Eq. 2.8) and standard deviation [mm] of the moving part's subsets against pitch "
        f"({METHOD}, reference {REFERENCE})."
    )
    return save(figure, folder / "chapter3_rms.png", caption, "RMS error and standard deviation against pitch.")


def _cracks(data: Chapter3, folder: Path) -> Picture:
    """Figure 3.15."""
    figure = new_figure(9.0, 3.4)
    left, right = figure.subplots(1, 2)
    for series, filled in (("crack A", True), ("crack B", False)):
        shots = data.series(series)
        numbers, cracks = tuple(shot.number for shot in shots), [shot.crack_mm for shot in shots]
        for variant, (label, style) in CALIBRATIONS.items():
            errors = data.errors("blobs", variant, "h_2d", references=(REFERENCE,), shots=numbers)[0]
            marks = {**style, "markerfacecolor": style["color"] if filled else "white", "markersize": 5, "linewidth": 1}
            left.plot(cracks, errors, label=f"{label}, set {series[-1]}", **marks)
        for method, style in METHOD_MARKS.items():
            errors = data.errors("blobs", "8 bit", method, references=(REFERENCE,), shots=numbers)[0]
            face = style["color"] if filled else "white"
            right.plot(
                cracks,
                1e3 * errors,
                label=f"{method}, set {series[-1]}",
                markerfacecolor=face,
                markersize=5,
                linewidth=1,
                linestyle="-" if filled else "--",
                **style,
            )
    left.set_title("h_2d with three calibrations", loc="left")
    left.set_ylabel("measured - actual [mm]")
    right.set_title("true K", loc="left")
    right.set_ylabel("measured - actual [1e-3 mm]")
    for ax in (left, right):
        ax.axhline(0, color=BLACK, linewidth=0.8, alpha=0.5)
        ax.set_xlabel("crack [mm]")
        ax.legend()
    caption = (
        "Figure 3.15: measured minus actual crack [mm] for cracks of 2 to 50 mm, two sets of five images "
        f"(band-limited pattern, reference {REFERENCE}). Left: a wrong focal length is an error of scale. "
        "Right: the true K, in thousandths of a millimetre."
    )
    return save(figure, folder / "chapter3_cracks.png", caption, "Error against the size of the crack.")


def _oblique(data: Chapter3, folder: Path) -> Picture:
    """Errors and uncertainties far beyond the thesis."""
    series = [one for one in SERIES if one.name in data.scope.series]
    figure = new_figure(2.6 * len(series) + 0.8, 2.1 * len(data.scope.lenses) + 0.7)
    grid = figure.subplots(len(data.scope.lenses), len(series), squeeze=False, sharey=True)
    for row, lens in zip(grid, data.scope.lenses, strict=True):
        for ax, one in zip(row, series, strict=True):
            steps = [step for step in data.oblique[one.name, lens] if "methods" in step]
            values = np.array([step["value"] for step in steps])
            for method, style in METHOD_MARKS.items():
                summaries = [step["methods"][method] for step in steps]
                errors = np.array([abs(summary["opening"] - CRACK_MM) for summary in summaries])
                sigma = np.array([summary["u_opening"] for summary in summaries])
                ax.plot(values, np.maximum(errors, 1e-6), linestyle="none", markersize=3.5, label=method, **style)
                dash = {"h_3d": "--", "h_2d": "-.", "h_pose": "-"}[method]
                ax.plot(values, sigma, color=style["color"], linestyle=dash, linewidth=1)
            ax.set_yscale("log")
            ax.set_ylim(1e-5, 0.2)
            if one.name == "distance":
                ax.set_xscale("log")
                ax.set_xticks([0.5, 1, 2, 3])
                ax.xaxis.set_major_formatter(ScalarFormatter())
                ax.minorticks_off()
        row[0].set_ylabel(f"{lens}\n[mm]")
    for ax, one in zip(grid[-1], series, strict=True):
        ax.set_xlabel(f"{one.name} [{one.unit}]")
    _legend(figure, grid[0][0])
    caption = (
        "Error of an opening of 10 mm (marks) and its standard uncertainty (lines) [mm], band-limited pattern, 8 bit. "
        "The reference faces the panel; each series is followed like a video."
    )
    return save(figure, folder / "chapter3_oblique.png", caption, "Error and uncertainty of strongly oblique views.")


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
