"""Pictures and maps: the images of the thesis' figures 3.4 to 3.6, its maps 2.5 and 2.6, and the trends of 3.12."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from numpy.typing import NDArray

from ....report import maps as report_maps
from ....report.drawing import Picture, appearance, new_figure, save
from ....runs import Run
from ..calibrating import board_image
from ..measuring import Measured, Tracked, measure, panel_regions, track, track_again
from ..rendering import Renderer, exposed
from ..shots import REFERENCES, all_shots
from ..tasks import SETTINGS, SUBSET

Array = NDArray[np.float64]

MAPPED = 11  # yaw of 15 degrees: the image of the maps
TRENDS = {"yaw": 11, "pitch": 21, "roll": 31}  # of 15 degrees each
REFERENCE = REFERENCES[0]


def draw(folder: Path, into: Path) -> list[Picture]:
    """Write all of them.

    Args:
        folder: of the run, which has the images.
    """
    into.mkdir(parents=True, exist_ok=True)
    with appearance():
        return [_images(folder, into), *_displacements(folder, into), _trends(folder, into)]


def _images(folder: Path, into: Path) -> Picture:
    figure = new_figure(9.0, 2.3)
    axes = figure.subplots(1, 3)
    renderer = Renderer(folder)
    for ax, (pattern, title) in zip(axes, (("disks", "disks"), ("blobs", "band-limited")), strict=False):
        image = exposed(renderer.radiance(all_shots()[MAPPED], pattern))
        ax.imshow(image[290:430, 510:760], cmap="gray", vmin=0, vmax=255, extent=(510, 760, 430, 290))
        ax.set_title(f"{title}, image {MAPPED:04d}", loc="left")
    axes[2].imshow(board_image(0), cmap="gray", vmin=0, vmax=255)
    axes[2].set_title("view of the checkerboard", loc="left")
    for ax in axes:
        ax.set_xlabel("x [px]")
    axes[0].set_ylabel("y [px]")
    caption = (
        "Part of an image with either pattern and the crack of 10 mm (x, y in px), and a view for the calibration."
    )
    return save(figure, into / "chapter3_images.png", caption, "Both patterns and the checkerboard.")


def _tracked(folder: Path, number: int) -> tuple[Tracked, tuple[NDArray, NDArray]]:
    renderer = Renderer(folder)
    images = tuple(exposed(renderer.radiance(shot, "blobs")) for shot in (REFERENCE, all_shots()[number]))
    return track(REFERENCE, images, SETTINGS), images


def _displacements(folder: Path, into: Path) -> list[Picture]:
    """Figures 2.5 and 2.6."""
    tracked, _ = _tracked(folder, MAPPED)
    measured = measure(tracked, REFERENCE, all_shots()[MAPPED], methods=("h_3d", "pc_3d"))
    regions = panel_regions(REFERENCE, SUBSET)
    pictures = []
    for figure, (method, one) in zip(("2_5", "2_6"), measured.items(), strict=True):
        run = Run([one.opening], {method: {"last": one.field}}, tracked.reference, {}, {})
        (picture,) = report_maps.draw(run, regions, into)
        path = into / f"chapter3_maps_{figure}.png"
        picture.path.replace(path)
        caption = f"Figure {figure.replace('_', '.')}: image {MAPPED:04d}, {method}. {picture.caption}"
        pictures.append(Picture(path, caption, picture.alt))
    return pictures


def _trends(folder: Path, into: Path) -> Picture:
    """Figure 3.12: where the displacement is wrong at high angles, with affine subsets and with second-order maps."""
    figure = new_figure(7.2, 8.4)
    grid = figure.subplots(3, 4, sharex=True, sharey=True)
    grid[0][0].invert_yaxis()
    regions = panel_regions(REFERENCE, SUBSET)
    for row, (series, number) in zip(grid, TRENDS.items(), strict=True):
        shot = all_shots()[number]
        tracked, images = _tracked(folder, number)
        kinds = {"affine": track_again(tracked, REFERENCE, images, SETTINGS, "affine"), "second order": tracked}
        for kind, columns in zip(kinds, (row[:2], row[2:]), strict=True):
            one = measure(kinds[kind], REFERENCE, shot, methods=("h_3d",))["h_3d"]
            for ax, part in zip(columns, ("fixed", "moving"), strict=True):
                shown = _draw_errors(
                    ax, one, regions.crack.members(kinds[kind].reference.centres_px), part, shot.crack_mm
                )
                ax.set_title(f"{kind}, {part}", loc="left")
        row[0].set_ylabel(f"{series} 15°\ny [px]")
        figure.colorbar(shown, ax=row, label="error of x [1e-3 mm]", extend="both", shrink=0.9)
    for ax in grid[-1]:
        ax.set_xlabel("x [px]")
    caption = (
        "Figure 3.12: error of the x displacement [1e-3 mm] of the fixed and of the moving part at 15 degrees of yaw, "
        "pitch and roll (h_3d, reference 0, band-limited pattern), with plain affine subsets (left) and with "
        "second-order maps (right)."
    )
    return save(figure, into / "chapter3_trends.png", caption, "Maps of the error at high angles.")


def _draw_errors(ax: Axes, one: Measured, zones: tuple[NDArray, NDArray], part: str, crack_mm: float) -> PathCollection:
    zone = zones[0] if part == "fixed" else zones[1]
    error = 1e3 * one.field.displacement_m[zone, 0] - (0 if part == "fixed" else crack_mm)
    x, y = one.field.centres_px[zone].T
    ax.set_aspect("equal")
    return ax.scatter(x, y, c=1e3 * error, s=4, marker="s", cmap="RdYlBu_r", vmin=-12, vmax=12, linewidths=0)
