"""maps_<method>_<label>.png: displacement of every subset on the reference image (thesis Figure 2.5, 2.6)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ..core.displacement_field import DisplacementField
from ..core.regions import Regions
from ..runs import Run
from .drawing import Picture, method_order, new_figure, save
from .map_background import Background
from .map_sides import Side, sides_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LABEL_WORDS = {"widest": "the widest opening", "last": "the last valid frame"}
CHOSEN = re.compile(r"at_(.*)_s")  # labels of chosen moments
NARROWEST_MM = 1e-4  # a colour range is not narrower, so that rounding does not look like displacement
WIDTH_IN = 4.5  # of one map with its colour bar


def draw(run: Run, regions: Regions | None, folder: Path) -> list[Picture]:
    """Write a figure for each displacement field of the run."""
    pictures = []
    for method in method_order(run.maps):
        openings = {o.stamp_ns: o.opening_m * 1e3 for o in run.openings if o.method == method and o.valid}
        for label, words, field in _distinct(run.maps[method], bool(openings)):
            since = (field.stamp_ns - field.reference_stamp_ns) * 1e-9
            title = f"{method} at {words}, {since:.2f} s after the reference"
            if field.stamp_ns in openings:
                title += f": opening {openings[field.stamp_ns]:.4f} mm"
            path = folder / f"maps_{method}_{label}.png"
            pictures.append(_draw_field(run, regions, field, title, path, explained=not pictures))
    return pictures


def _distinct(
    labelled: Mapping[str, DisplacementField], has_openings: bool
) -> list[tuple[str, str, DisplacementField]]:
    """(label, words, field) of each frame, once if two labels mean it; without a crack nothing is widest."""
    labels_of: dict[int, list[str]] = {}
    for label, field in labelled.items():
        if has_openings or label != "widest" or len(labelled) == 1:
            labels_of.setdefault(field.stamp_ns, []).append(label)
    return [(labels[0], " and ".join(map(_words, labels)), labelled[labels[0]]) for labels in labels_of.values()]


def _words(label: str) -> str:
    chosen = CHOSEN.fullmatch(label)
    return f"the frame nearest to {chosen[1]} s" if chosen else LABEL_WORDS.get(label, label)


def _draw_field(
    run: Run, regions: Regions | None, field: DisplacementField, title: str, path: Path, explained: bool
) -> Picture:
    sides = sides_of(regions, field)
    neither = ~np.any([side.members for side in sides], axis=0)
    shown = [0, 1] + [2] * bool(np.isfinite(field.displacement_m[:, 2]).any())
    background = Background.of(run.reference, regions, field)
    height = max(1.6, 0.72 * WIDTH_IN * background.aspect + 0.5)
    maps = [(axis, side) for axis in shown for side in sides]
    rows = math.ceil(len(maps) / 2)
    figure = new_figure(2 * WIDTH_IN, height * rows + 0.9)
    for place, (axis, side) in enumerate(maps):
        axes = figure.add_subplot(rows, 2, place + 1)
        _draw_map(axes, field, axis, side, neither, background)
        axes.set_ylabel("y in the reference image [px]" if place % 2 == 0 else "")
        axes.set_xlabel("x in the reference image [px]" if place + 2 >= len(maps) else "")
    figure.suptitle(title, fontsize=10)
    missing = ~neither & ~np.isfinite(field.displacement_m[:, shown]).all(axis=1)
    handles = background.legend(bool(neither.any()), bool(missing.any()))
    figure.legend(handles=handles, loc="outside lower center", ncols=5)
    names = " and of the ".join(side.name for side in sides)
    into_wall = " z is into the wall." if 2 in shown else ""
    caption = f"{title}.{into_wall}"
    if explained:
        own = "Each side has a colour range of its own, " if len(sides) > 1 else "The colours range "
        caption = (
            f"Displacement [mm] since the reference, camera motion removed: {title}. x and y are along the axes of the "
            f"panel.{into_wall} {own}from the 1st to the 99th percentile, for a fixed region symmetric about zero."
        )
        if neither.any():
            caption += " Grey subsets touch the crack or lie before it, and belong to neither side."
    alt = f"Maps of the {', '.join('xyz'[axis] for axis in shown)} displacement of the {names}: {title}."
    return save(figure, path, caption, alt)


def _draw_map(
    axes: Axes, field: DisplacementField, axis: int, side: Side, neither: Mask, background: Background
) -> None:
    values = field.displacement_m[:, axis] * 1e3
    known = values[side.members & np.isfinite(values)]
    background.draw(axes)
    if side.moves:
        background.draw_neither(axes, neither)
    background.draw_missing(axes, side.members & ~np.isfinite(values))
    axes.set_title(f"{'xyz'[axis]}, {side.name}\n{_spread(known)}", loc="left")
    if not len(known):
        return
    low, high = _colour_range(known, around_zero=not side.moves)
    cells = axes.imshow(
        background.on_grid(np.where(side.members, values, np.nan)),
        extent=background.grid_extent,
        cmap="viridis" if side.moves else "RdYlBu_r",
        vmin=low,
        vmax=high,
        interpolation="nearest",
        zorder=2,
    )
    beyond = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    extend = beyond[bool(known.min() < low), bool(known.max() > high)]
    bar = axes.figure.colorbar(cells, ax=axes, extend=extend, shrink=0.9, pad=0.02)
    bar.formatter.set_scientific(False)
    bar.set_label(f"{'xyz'[axis]} displacement [mm]")


def _spread(known: Array) -> str:
    if not len(known):
        return "no valid displacement"
    spread = f", spread {known.std(ddof=1):.4f} mm" if len(known) > 1 else ""
    return f"mean {round(known.mean(), 4) + 0.0:.4f} mm{spread}"


def _colour_range(known: Array, around_zero: bool) -> tuple[float, float]:
    """From the 1st to the 99th percentile [mm], so that single subsets do not hide the others."""
    low, high = np.percentile(known, (1, 99))
    if around_zero:
        low, high = -max(-low, high), max(-low, high)
    widen = max(NARROWEST_MM - (high - low), 0.0) / 2
    return low - widen, high + widen
