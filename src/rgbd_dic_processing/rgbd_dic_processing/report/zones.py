"""zone_sensitivity.png: the displacement in the measuring zones, and the opening if they are off (thesis 4.4.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.displacement_field import DisplacementField
from ..core.regions import CrackZones, Regions
from ..history.zone_sensitivity import ACROSS, ALONG, BOTH, LEFT, RIGHT, Misplacement, zone_sensitivity
from ..runs import Run
from .drawing import BLACK, BLUE, ORANGE, VERMILION, Picture, method_order, new_figure, save
from .map_background import Background

Array = NDArray[np.float64]

NAME = "zone_sensitivity.png"
LINES = {
    LEFT: {"color": ORANGE, "linestyle": "--"},
    RIGHT: {"color": BLUE, "linestyle": "-."},
    BOTH: {"color": BLACK, "linestyle": "-"},
}


def of_run(run: Run, regions: Regions | None) -> tuple[dict[str, list[Misplacement]], dict[str, str]]:
    """Method -> its sensitivities at the widest opening; and method -> why there are none."""
    found: dict[str, list[Misplacement]] = {}
    reasons: dict[str, str] = {}
    if regions is None or regions.crack is None or not run.openings:
        return found, reasons
    for method in method_order(run.maps):
        try:
            found[method] = zone_sensitivity(_widest(run, method), regions.crack)
        except RgbdDicError as error:
            reasons[method] = str(error)
    return found, reasons


def draw(run: Run, regions: Regions | None, found: Mapping[str, Sequence[Misplacement]], folder: Path) -> list[Picture]:
    """Write the figure of the first method; nothing if there is none."""
    if not found or regions is None or regions.crack is None:
        return []
    method = next(iter(found))
    figure = new_figure(9.0, 6.2)
    panels = figure.subplots(2, 2, gridspec_kw={"height_ratios": (1.25, 1)})
    field = _widest(run, method)
    background = Background.of(run.reference, regions, field)
    for axes, polygon, name in zip(
        panels[0], (regions.crack.left, regions.crack.right), ("left", "right"), strict=True
    ):
        _draw_zone(axes, field, background, regions.crack, polygon, name)
    low, high = np.inf, -np.inf
    for axes, axis, words in zip(panels[1], (ACROSS, ALONG), ("across the crack", "along the crack"), strict=True):
        for one in found[method]:
            if one.axis == axis:
                axes.plot(one.shift_px, one.opening_m * 1e3, label=one.moved, **LINES[one.moved])
                low, high = min(low, one.opening_m.min() * 1e3), max(high, one.opening_m.max() * 1e3)
        axes.axvline(0.0, color="0.6", linewidth=0.6, zorder=0)
        axes.set_xlabel("misplaced by [px]")
        axes.set_title(words, loc="left")
    margin = max(0.05 * (high - low), 1e-4)
    for axes in panels[1]:
        axes.set_ylim(low - margin, high + margin)
    panels[1, 0].set_ylabel("opening [mm]")
    handles, labels = panels[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    figure.suptitle(f"{method} at the widest opening", fontsize=10)
    caption = (
        "Above, the x displacement in each measuring zone (outlined) at the widest opening, with colours of its own. "
        "Below, the opening if the zones were elsewhere: one of two independent rectangles moved, or both together, as "
        "zones from a point on the crack do. A zone within half a subset of the crack takes in what the crack cuts."
    )
    return [save(figure, folder / NAME, caption, "Displacement inside the zones, and opening over their misplacement.")]


def _widest(run: Run, method: str) -> DisplacementField:
    labelled = run.maps[method]
    return labelled.get("widest", next(iter(labelled.values())))


def _draw_zone(
    axes: Axes, field: DisplacementField, background: Background, zones: CrackZones, polygon: Array, name: str
) -> None:
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    margin = 0.4 * (high - low).max()
    centres = field.centres_px.astype(float)
    near = ((centres >= low - margin) & (centres <= high + margin)).all(axis=1)
    near &= zones.beyond(centres) == (name == "right")
    values = np.where(near, field.displacement_m[:, 0] * 1e3, np.nan)
    limits = np.nanpercentile(values, (1, 99))
    cells = axes.imshow(
        background.on_grid(values), extent=background.grid_extent, cmap="viridis", vmin=limits[0], vmax=limits[1]
    )
    axes.figure.colorbar(cells, ax=axes, shrink=0.9, pad=0.02).set_label("x displacement [mm]")
    axes.plot(*np.vstack([polygon, polygon[:1]]).T, color=VERMILION, linewidth=1.4)
    axes.set_aspect("equal")
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(high[1] + margin, low[1] - margin)
    axes.set_title(f"{name} zone", loc="left")
    axes.set_xlabel("x in the reference image [px]")
    axes.set_ylabel("y in the reference image [px]")
