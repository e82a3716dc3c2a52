"""What lies under and around a displacement map: the dimmed reference image, the outlines, the grid."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ..core.displacement_field import DisplacementField
from ..core.regions import Regions
from ..core.subset_field import Reference
from .drawing import BLACK, VERMILION

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTLINES = {
    "panel": {"color": BLACK, "linestyle": "-", "linewidth": 0.8},
    "fixed region": {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 1.4},
    "measuring zones": {"color": VERMILION, "linestyle": "-", "linewidth": 1.4},
}
MISSING = {"marker": "x", "color": "0.2", "markersize": 3.5, "linestyle": "none", "markeredgewidth": 0.7}
NEITHER = 0.6  # grey level
HALO = [effects.withStroke(linewidth=2.6, foreground="white")]


@dataclass(frozen=True)
class Background:
    """Everything but the colours, the same for all maps of a field.

    low_px, high_px: corners of what is shown. step_px: distance of the subsets, and the size of their cells.
    """

    image: NDArray[np.uint8] | None
    outlines: tuple[tuple[str, Array], ...]
    centres_px: Array
    step_px: float
    low_px: Array
    high_px: Array

    @classmethod
    def of(cls, reference: Reference | None, regions: Regions | None, field: DisplacementField) -> Background:
        centres = field.centres_px.astype(float)
        step = float(reference.step) if reference is not None else _smallest_step(centres)
        outlines = _outlines(regions)
        shown = np.vstack([centres - step, centres + step, *(polygon for _, polygon in outlines)])
        low, high = shown.min(axis=0), shown.max(axis=0)
        margin = 0.03 * (high - low).max()
        image = None if reference is None else reference.image
        return cls(image, outlines, centres, step, low - margin, high + margin)

    @property
    def aspect(self) -> float:
        """Height over width of what is shown."""
        width, height = self.high_px - self.low_px
        return float(height / width)

    @property
    def grid_extent(self) -> tuple[float, float, float, float]:
        half = self.step_px / 2
        low, high = self.centres_px.min(axis=0) - half, self.centres_px.max(axis=0) + half
        return low[0], high[0], high[1], low[1]

    def on_grid(self, values: Array) -> Array:
        """Values (N,) as an image of one cell for each subset (rows, cols), NaN where there is none."""
        cells = np.round((self.centres_px - self.centres_px.min(axis=0)) / self.step_px).astype(int)
        grid = np.full(cells.max(axis=0)[::-1] + 1, np.nan)
        grid[cells[:, 1], cells[:, 0]] = values
        return grid

    def draw(self, axes: Axes) -> None:
        if self.image is not None:
            axes.imshow(0.65 + 0.35 * self.image / 255.0, cmap="gray", vmin=0, vmax=1, zorder=1)
        for name, polygon in self.outlines:
            closed = np.vstack([polygon, polygon[:1]])
            axes.plot(*closed.T, zorder=4, path_effects=HALO, **OUTLINES[name])
        axes.set_aspect("equal")
        axes.set_xlim(self.low_px[0], self.high_px[0])
        axes.set_ylim(self.high_px[1], self.low_px[1])

    def draw_missing(self, axes: Axes, missing: Mask) -> None:
        if missing.any():
            axes.plot(*self.centres_px[missing].T, zorder=3, **MISSING)

    def draw_neither(self, axes: Axes, neither: Mask) -> None:
        if neither.any():
            grey = self.on_grid(np.where(neither, 0.5, np.nan))
            axes.imshow(grey, extent=self.grid_extent, cmap="gray", vmin=0, vmax=0.5 / NEITHER, zorder=2)

    def legend(self, with_neither: bool, with_missing: bool) -> list[Artist]:
        drawn = dict.fromkeys(name for name, _ in self.outlines)
        lines = [Line2D([], [], label=name, **OUTLINES[name]) for name in drawn]
        grey = [Patch(color=str(NEITHER), label="on neither side")] * with_neither
        cross = [Line2D([], [], label="without a valid displacement", **MISSING)] * with_missing
        return [*lines, *grey, *cross]


def _outlines(regions: Regions | None) -> tuple[tuple[str, Array], ...]:
    if regions is None:
        return ()
    zones = () if regions.crack is None else (regions.crack.left, regions.crack.right)
    return (
        ("panel", regions.panel),
        *(("fixed region", polygon) for polygon in (*regions.fixed, *regions.fixed_holes)),
        *(("measuring zones", polygon) for polygon in zones),
    )


def _smallest_step(centres_px: Array) -> float:
    steps = np.concatenate([np.diff(np.unique(coordinates)) for coordinates in centres_px.T])
    return float(steps.min()) if len(steps) else 1.0
