"""overview.png: the result at a glance: where was measured, and how far the crack opened."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ..core.displacement_field import DisplacementField
from ..core.regions import Regions
from ..runs import Run
from .drawing import BLUE, TIME_LABEL, TRUTH_LINE, Picture, new_figure, plot_band, plot_values, save, time_range_s
from .map_background import Background
from .map_sides import on_crack
from .series import Series

NAME = "overview.png"


def draw(run: Run, regions: Regions | None, methods: Sequence[Series], folder: Path) -> list[Picture]:
    """Write the figure for the first method; nothing if it has no valid opening or no map of the widest."""
    if not methods or not methods[0].valid.any() or "widest" not in run.maps.get(methods[0].method, {}):
        return []
    series, field = methods[0], run.maps[methods[0].method]["widest"]
    known = bool(np.isfinite(series.error_mm).any())
    figure = new_figure(10.5, 4.0)
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.2, 1))
    _draw_panel(figure.add_subplot(left), run, regions, field)
    rows = right.subgridspec(2, 1, height_ratios=(2.4, 1)) if known else right.subgridspec(1, 1)
    history = figure.add_subplot(rows[0])
    widest = int(np.nanargmax(np.abs(series.opening_mm)))
    words = f"{series.opening_mm[widest]:.3f} mm, standard uncertainty {series.u_mm[widest]:.4f} mm"
    _draw_history(history, series)
    history.set_title(f"widest opening {words}", loc="left")
    if known:
        history.tick_params(labelbottom=False)
        _draw_error(figure.add_subplot(rows[1], sharex=history), series)
    figure.axes[-1].set_xlabel(TIME_LABEL)
    caption = (
        "Left, how far each subset moved along the panel, camera motion removed, at the widest opening; those that "
        f"touch the crack are left out. Right, the opening of the crack by {series.method}, with bands of plus and "
        "minus two standard uncertainties."
    )
    alt = f"Map of the displacement at the widest opening, and the opening over time: {words}."
    return [save(figure, folder / NAME, caption, alt)]


def _draw_panel(axes: Axes, run: Run, regions: Regions | None, field: DisplacementField) -> None:
    background = Background.of(run.reference, regions, field)
    moved_mm = np.hypot(*field.displacement_m[:, :2].T) * 1e3
    if regions is not None and regions.crack is not None:
        moved_mm[on_crack(regions.crack, field)] = np.nan
    background.draw(axes)
    cells = axes.imshow(
        background.on_grid(moved_mm),
        extent=background.grid_extent,
        cmap="viridis",
        vmin=0.0,
        vmax=max(float(np.nanpercentile(moved_mm, 99)), 1e-4) if np.isfinite(moved_mm).any() else 1.0,
        alpha=0.85,
        zorder=2,
    )
    axes.figure.colorbar(cells, ax=axes, location="bottom", aspect=40, pad=0.02).set_label("displacement [mm]")
    axes.axis("off")
    handles = background.legend(False, False)
    axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=max(len(handles), 1))


def _draw_history(axes: Axes, series: Series) -> None:
    if np.isfinite(series.truth_mm).any():
        plot_values(axes, series.time_s, series.truth_mm, "truth", **TRUTH_LINE)
    plot_band(axes, series.time_s, series.opening_mm - 2 * series.u_mm, series.opening_mm + 2 * series.u_mm, BLUE)
    plot_values(axes, series.time_s, series.opening_mm, series.method, color=BLUE, linewidth=1.6)
    axes.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    axes.set_xlim(*time_range_s(series.time_s[-1]))
    axes.set_ylabel("crack opening [mm]")
    axes.legend(loc="upper left")


def _draw_error(axes: Axes, series: Series) -> None:
    error, u = series.error_mm * 1e3, series.u_mm * 1e3
    plot_band(axes, series.time_s, -2 * u, 2 * u, BLUE, outlined=True)
    plot_values(axes, series.time_s, error, color=BLUE, linewidth=1.2)
    axes.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    reach = 1.15 * max(np.nanmax(np.abs(error)), np.nanpercentile(2 * u, 95), 1e-3)
    axes.set_ylim(-reach, reach)
    axes.set_ylabel("error [\u00b5m]")
