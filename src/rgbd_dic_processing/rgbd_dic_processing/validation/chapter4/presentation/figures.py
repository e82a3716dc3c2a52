"""Figures 4.15, 4.16 and 4.20 redrawn from a run, and what goes beyond the thesis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from ....report.drawing import (
    BLACK,
    TRUTH_LINE,
    Picture,
    appearance,
    line_of,
    method_order,
    new_figure,
    plot_values,
    save,
)
from ..chapter import MAPPED, METHODS, Chapter4
from ..errors import COMPONENTS
from ..regions import usual_region

Array = NDArray[np.float64]


def draw(data: Chapter4, folder: Path) -> list[Picture]:
    """Write every figure that needs no more than the numbers of the run."""
    with appearance():
        return [_maps(data, folder), _map_errors(data, folder), _history(data, folder), _budget(data, folder)]


def _shown() -> list[str]:
    """The methods whose maps are drawn."""
    return [method for method in ("h_2d", "h_3d", "h_joint") if method in METHODS]


def _maps(data: Chapter4, folder: Path) -> Picture:
    """Figures 4.15 and 4.16: displacement of the panel, the truth on the left."""
    methods = _shown()
    columns = ["true", *methods]
    figure = new_figure(2.9 * len(columns), 3.6)
    grid = figure.subplots(2, len(columns), sharex=True, sharey=True, squeeze=False)
    for axis, row in enumerate(grid):
        true = np.array(data.maps[methods[0]]["true"])[:, axis]
        low, high = np.nanpercentile(true - np.nanmean(true), (1, 99))
        for ax, name in zip(row, columns, strict=True):
            entry = data.maps[methods[0] if name == "true" else name]
            values = np.array(entry["true" if name == "true" else "measured"])[:, axis]
            shown = _draw_map(ax, entry, values - np.nanmean(values), low, high, "viridis")
            ax.set_title(f"{'xy'[axis]}, {name}", loc="left")
        figure.colorbar(shown, ax=row, label="[mm]", extend="both", shrink=0.9)
    _label_pixels(grid)
    entry = data.maps[methods[0]]
    caption = (
        f"Figures 4.15 and 4.16: displacement [mm] of the panel at its widest opening ({entry['time_s']:.2f} s; "
        f"`{MAPPED[0]}`, seed {MAPPED[1]}), less its mean: the truth, and the methods with the whole panel as region."
    )
    return save(figure, folder / "chapter4_maps.png", caption, "Maps of the displacement, true and measured.")


def _map_errors(data: Chapter4, folder: Path) -> Picture:
    """What each method loses of the field."""
    methods = [method for method in method_order(METHODS) if method != "pc_3d"]
    figure = new_figure(2.9 * len(methods), 3.6)
    grid = figure.subplots(2, len(methods), sharex=True, sharey=True, squeeze=False)
    for axis, row in enumerate(grid):
        limit = max(1e-3, *(np.nanpercentile(np.abs(np.array(data.maps[m]["error"])[:, axis]), 98) for m in _shown()))
        for ax, method in zip(row, methods, strict=True):
            values = np.array(data.maps[method]["error"])[:, axis]
            shown = _draw_map(ax, data.maps[method], values, -limit, limit, "RdYlBu_r")
            ax.set_title(f"{'xy'[axis]}, {method}: RMS {np.sqrt(np.nanmean(values**2)):.4f} mm", loc="left")
        figure.colorbar(shown, ax=row, label="error [mm]", extend="both", shrink=0.9)
    _label_pixels(grid)
    caption = (
        "Measured minus true displacement [mm] of the same image, up to a rigid motion of the panel in its plane: what "
        "each method loses of the field. In the plane `pc_3d` is as `h_3d`. Subsets that see both sides of the "
        "crack are left out."
    )
    return save(figure, folder / "chapter4_map_errors.png", caption, "Maps of the error of each method.")


def _history(data: Chapter4, folder: Path) -> Picture:
    """Figure 4.20, with the errors below."""
    field, seed = MAPPED
    region = usual_region(field)
    figure = new_figure(9.0, 6.6)
    grid = figure.subplots(3, 2, sharex=True, height_ratios=(1.2, 1, 1))
    histories = {method: data.histories[field, seed, method, region] for method in method_order(METHODS)}
    some = next(iter(histories.values()))
    stereo = data.stereo[field, seed]
    noisy = [method for method in histories if method in ("h_3d", "pc_3d")]
    for column, component in enumerate(COMPONENTS):
        top, *below = grid[:, column]
        top.plot(some.time_s, some.columns[f"true_{component}"], label="truth", **TRUTH_LINE)
        for method, history in histories.items():
            if method != "pc_3d":
                plot_values(top, history.time_s, history.columns[component], method, **line_of(method))
            ax = below[0] if method in noisy else below[1]
            plot_values(ax, history.time_s, history.error(component), method, **line_of(method))
        top.plot(
            stereo["time_s"],
            stereo[component],
            "o",
            color=BLACK,
            markersize=3.5,
            markerfacecolor="white",
            label="3D DIC",
        )
        top.set_title(component, loc="left")
        top.set_xlim(some.time_s[0], some.time_s[-1])
        top.set_ylabel("[mm]")
        for ax in below:
            ax.axhline(0, color=BLACK, linewidth=0.8, alpha=0.5)
            ax.set_ylabel("error [mm]")
        below[-1].set_xlabel("time [s]")
    for ax in grid[:, 1]:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    caption = (
        f"Figure 4.20: opening and sliding [mm] over time (`{field}`, seed {seed}, whole panel as region), with the "
        "simulated 3D DIC as its late clock has it, and the errors of each method."
    )
    return save(figure, folder / "chapter4_history.png", caption, "Opening and sliding over time, and their errors.")


def _budget(data: Chapter4, folder: Path) -> Picture:
    """RMS of each error source alone."""
    sources = list(data.scope.sources)
    figure = new_figure(9.0, 0.33 * len(sources) + 1.3)
    axes = figure.subplots(1, 2, sharey=True, sharex=True)
    marks = dict(zip(method_order(METHODS), "osD^v<>", strict=False))
    for ax, component in zip(axes, COMPONENTS, strict=True):
        for shift, (method, mark) in zip(np.linspace(-0.2, 0.2, len(marks)), marks.items(), strict=True):
            values = [
                np.sqrt(np.mean([data.budget[s, seed, method].rms(component) ** 2 for seed in data.scope.budget_seeds]))
                for s in sources
            ]
            color = line_of(method)["color"]
            ax.plot(
                values,
                np.arange(len(sources)) + shift,
                mark,
                color=color,
                markersize=5,
                markerfacecolor="none",
                label=method,
            )
        ax.set_xscale("log")
        ax.grid(axis="both", linewidth=0.4, alpha=0.5)
        ax.set_title(component, loc="left")
        ax.set_xlabel("RMS error [mm]")
    axes[0].set_yticks(range(len(sources)), sources)
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    caption = (
        "Error budget: RMS error [mm] with one error source switched on at a time. The left half is rigid and the "
        "fixed region; where nothing is rigid the field is `beam` and the whole panel the region."
    )
    return save(figure, folder / "chapter4_budget.png", caption, "RMS error of each error source alone.")


def _draw_map(ax: Axes, entry: dict[str, Any], values: Array, low: float, high: float, colours: str) -> AxesImage:
    """Values (N,) of the subsets, a cell each."""
    (xs, column), (ys, row) = (np.unique(line, return_inverse=True) for line in np.array(entry["centres_px"]).T)
    cells = np.full((len(ys), len(xs)), np.nan)
    cells[row, column] = values
    half = (xs[1] - xs[0]) / 2
    extent = (xs[0] - half, xs[-1] + half, ys[-1] + half, ys[0] - half)
    return ax.imshow(cells, extent=extent, cmap=colours, vmin=low, vmax=high, interpolation="nearest")


def _label_pixels(grid: NDArray) -> None:
    for ax in grid[-1]:
        ax.set_xlabel("x [px]")
    for ax in grid[:, 0]:
        ax.set_ylabel("y [px]")
