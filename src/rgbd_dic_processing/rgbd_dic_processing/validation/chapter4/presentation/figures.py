"""Figures 4.15 to 4.27 redrawn from a run, and what goes beyond the thesis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError

from ....core.regions import Regions
from ....core.regions_file import load_regions
from ....history.comparison import compare_run
from ....history.record import start_of
from ....report import zones
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
from ....report.map_background import Background
from ....report.reference import draw as draw_reference
from ....report.series import of_run as series_of_run
from ....runs import Run
from ..alignment import stereo_history
from ..chapter import EVERY, MAPPED, METHODS, Chapter4
from ..errors import COMPONENTS, rms
from ..example import time_of, truth_m
from ..measuring import THESIS_H_2D, map_error_m
from ..regions import usual_region
from ..scenes import open_laboratory

Array = NDArray[np.float64]


def draw(data: Chapter4, run_folder: Path, folder: Path) -> list[Picture]:
    """Write every figure that needs no more than the numbers of the run."""
    run = Run.load(run_folder / data.example)
    regions = load_regions(run_folder / data.example / "regions.yaml")
    with appearance():
        return [
            *_maps(data, run, regions, folder),
            _history(data, folder),
            *_aligned(data, run, folder),
            *_zones(run, regions, folder),
            _budget(data, folder),
        ]


def _shown() -> list[str]:
    """The methods whose maps are drawn."""
    return [method for method in (THESIS_H_2D, "h_2d", "h_3d", "h_joint") if method in EVERY]


def _maps(data: Chapter4, run: Run, regions: Regions, folder: Path) -> list[Picture]:
    """Figures 4.15 and 4.16, and what each method loses of the field."""
    lab = open_laboratory(data.scope.laboratory(*MAPPED))
    fields = {method: run.maps[method]["widest"] for method in method_order(EVERY)}
    some = next(iter(fields.values()))
    truth = truth_m(lab, some)
    errors = {method: 1e3 * map_error_m(field, truth, regions) for method, field in fields.items()}
    displacements = {"true": 1e3 * truth} | {method: 1e3 * fields[method].displacement_m for method in _shown()}
    background = Background.of(None, None, some)
    time_s = time_of(lab, some)
    return [_displacements(displacements, background, time_s, folder), _map_errors(errors, background, folder)]


def _displacements(values: dict[str, Array], background: Background, time_s: float, folder: Path) -> Picture:
    figure = new_figure(2.9 * len(values), 3.6)
    grid = figure.subplots(2, len(values), sharex=True, sharey=True, squeeze=False)
    for axis, row in enumerate(grid):
        centred = {name: entry[:, axis] - np.nanmean(entry[:, axis]) for name, entry in values.items()}
        low, high = np.nanpercentile(centred["true"], (1, 99))
        for ax, (name, cells) in zip(row, centred.items(), strict=True):
            shown = _draw_map(ax, background, cells, low, high, "viridis")
            ax.set_title(f"{'xy'[axis]}, {name}", loc="left")
        figure.colorbar(shown, ax=row, label="[mm]", extend="both", shrink=0.9)
    _label_pixels(grid)
    caption = (
        f"Figures 4.15 and 4.16: displacement [mm] of the panel at its widest opening ({time_s:.2f} s; "
        f"`{MAPPED[0]}`, seed {MAPPED[1]}), less its mean: the truth, and the methods with the whole panel as region."
    )
    return save(figure, folder / "chapter4_maps.png", caption, "Maps of the displacement, true and measured.")


def _map_errors(errors: dict[str, Array], background: Background, folder: Path) -> Picture:
    shown_methods = [method for method in errors if method != "pc_3d"]
    figure = new_figure(2.9 * len(shown_methods), 3.6)
    grid = figure.subplots(2, len(shown_methods), sharex=True, sharey=True, squeeze=False)
    for axis, row in enumerate(grid):
        limit = max(1e-3, *(np.nanpercentile(np.abs(errors[method][:, axis]), 98) for method in shown_methods))
        for ax, method in zip(row, shown_methods, strict=True):
            values = errors[method][:, axis]
            shown = _draw_map(ax, background, values, -limit, limit, "RdYlBu_r")
            ax.set_title(f"{'xy'[axis]}, {method}: RMS {rms(values):.4f} mm", loc="left")
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
    reference, _ = stereo_history(data.scope.laboratory(field, seed))
    late = {"opening": reference.opening_m, "sliding": reference.sliding_m}
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
            reference.time_s,
            1e3 * late[component],
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


def _aligned(data: Chapter4, run: Run, folder: Path) -> list[Picture]:
    """Figures 4.21 to 4.27, as `rgbd-dic report --reference` draws them; none if the run is too short."""
    reference, _ = stereo_history(data.scope.laboratory(*MAPPED))
    try:
        compared = compare_run(run.openings, reference, start_of(run.openings))
    except RgbdDicError:
        return []
    pictures = draw_reference(series_of_run(run.openings, None), reference, compared, folder)
    numbers = {"alignment": "4.25 to 4.27", "correlation": "4.23 and 4.24", "spectra": "4.21 and 4.22"}
    return [_as_ours(picture, f"Figures {numbers[picture.path.stem]}") for picture in pictures]


def _zones(run: Run, regions: Regions, folder: Path) -> list[Picture]:
    """Figures 4.18 and 4.19, as every report draws them."""
    chosen = "h_joint" if "h_joint" in METHODS else METHODS[0]
    found, _ = zones.of_run(replace(run, maps={chosen: run.maps[chosen]}), regions)
    return [_as_ours(picture, "Figures 4.18 and 4.19") for picture in zones.draw(run, regions, found, folder)]


def _as_ours(picture: Picture, figures: str) -> Picture:
    path = picture.path.with_name(f"chapter4_{picture.path.name}")
    picture.path.replace(path)
    return Picture(path, f"{figures}: {picture.caption}", picture.alt)


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


def _draw_map(ax: Axes, background: Background, values: Array, low: float, high: float, colours: str) -> AxesImage:
    """Values (N,) of the subsets, a cell each."""
    cells, extent = background.on_grid(values), background.grid_extent
    return ax.imshow(cells, extent=extent, cmap=colours, vmin=low, vmax=high, interpolation="nearest")


def _label_pixels(grid: NDArray) -> None:
    for ax in grid[-1]:
        ax.set_xlabel("x [px]")
    for ax in grid[:, 0]:
        ax.set_ylabel("y [px]")
