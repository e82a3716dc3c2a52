"""plane.png: the cloud, the selection and the plane of a ToF frame (Figures 4.9 to 4.11), and its residuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray

from ..plane_view import PlaneView
from .drawing import BLACK, GREEN, VERMILION, Picture, appearance, new_figure, save

Array = NDArray[np.float64]

DRAWN = 6000  # points of a cloud, evenly taken
GREY = "0.65"


def words(view: PlaneView) -> list[str]:
    """The numbers of a plane, a line each."""
    noise, both = view.uncertainty(view.plane.covariance), view.uncertainty(view.plane.covariance + view.systematic)
    tilts = np.degrees(view.tilts_rad)
    return [
        f"points on the panel: {len(view.selection_m)}, of them on the plane: {view.inliers.sum()} "
        f"({view.inliers.mean():.1%})",
        f"RMS residual along z: {view.rms_m * 1e3:.2f} mm",
        f"distance: {-view.plane.d * 1e3:.2f} mm, standard uncertainty {both[0] * 1e3:.2f} mm, of this frame alone "
        f"{noise[0] * 1e3:.2f} mm",
        *(
            f"{name}: {tilt:.3f} degrees, standard uncertainty {np.degrees(u):.3f}, of this frame alone "
            f"{np.degrees(own):.3f}"
            for name, tilt, u, own in zip(("yaw", "pitch"), tilts, both[1:], noise[1:], strict=True)
        ),
    ]


def draw_plane(view: PlaneView, path: Path) -> Picture:
    """Two views in space, the plane from its edge, and the residuals over the image."""
    with appearance():
        figure = new_figure(10.5, 8.6)
        grid = figure.add_gridspec(3, 2, height_ratios=(1, 0.8, 0.24))
        near, whole = (figure.add_subplot(grid[0, i], projection="3d") for i in (0, 1))
        _dots(near, view.selection_m, VERMILION)
        _in_space(near, view.selection_m, "points of the panel region (Figure 4.9)")
        _dots(whole, view.cloud_m, GREY)
        _dots(whole, view.selection_m, VERMILION)
        _in_space(whole, view.cloud_m, "the same in the whole cloud (Figure 4.10)")
        _from_the_edge(figure.add_subplot(grid[1, 0]), view)
        _residual_map(figure, figure.add_subplot(grid[1, 1]), view)
        text = figure.add_subplot(grid[2, :])
        text.axis("off")
        text.text(0, 1, "\n".join(words(view)), va="top", transform=text.transAxes)
        return save(figure, path, "Plane of one ToF frame.", "cloud, selection and plane of a ToF frame, and residuals")


def _some(count: int) -> NDArray[np.intp]:
    return np.linspace(0, count - 1, min(count, DRAWN)).astype(int)


def _dots(ax: Axes3D, points_m: Array, colour: str) -> None:
    x, y, z = points_m[_some(len(points_m))].T
    ax.scatter(x, z, -y, s=0.6, color=colour, depthshade=False, linewidths=0)


def _in_space(ax: Axes3D, points_m: Array, title: str) -> None:
    ax.set(xlabel="x [m]", ylabel="z, depth [m]", zlabel="-y [m]", title=title)
    size = np.ptp(points_m[:, [0, 2, 1]], axis=0)
    ax.set_box_aspect(np.maximum(size, 0.4 * size.max()), zoom=0.9)
    ax.view_init(elev=16, azim=-55)
    ax.tick_params(pad=0, labelsize=7)
    ax.locator_params(nbins=4)
    ax.locator_params(axis="y", nbins=2)


def _from_the_edge(ax: Axes, view: PlaneView) -> None:
    chosen = _some(len(view.selection_m))
    x, off = view.selection_m[chosen, 0], 1e3 * view.residuals_m[chosen]
    kept = view.inliers[chosen]
    limit = 1.5 * np.abs(off[kept]).max()
    ax.plot(x[kept], off[kept], ".", markersize=1.2, color=VERMILION, label="point of the region")
    ax.plot(x[~kept], off[~kept], "x", markersize=3, markeredgewidth=0.7, color="0.35", label="left out by the fit")
    ax.plot(view.corners_m[:2, 0], [0, 0], color=GREEN, linewidth=2.5, label="plane")
    beyond = np.count_nonzero(np.abs(off) > limit)
    ax.set(xlabel="x [m]", ylabel="behind the plane [mm]", ylim=(-limit, limit))
    ax.set_title("plane and points, from the edge (Figure 4.11)" + (f"; {beyond} points are farther" if beyond else ""))
    ax.legend(loc="upper right", ncols=3, markerscale=3, frameon=True)


def _residual_map(figure: Figure, ax: Axes, view: PlaneView) -> None:
    rows, columns = view.image.shape
    extent = (-0.5, columns - 0.5, rows - 0.5, -0.5)
    kept, pixels = view.inliers, view.pixels
    cell = 2 * np.sqrt(np.prod(np.ptp(pixels, axis=0)) / len(pixels))  # holds about four points
    edges = [np.arange(-0.5, size, cell) for size in (columns, rows)]
    count, *_ = np.histogram2d(*pixels[kept].T, bins=edges)
    total, *_ = np.histogram2d(*pixels[kept].T, bins=edges, weights=1e3 * view.residuals_m[kept])
    mean = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0).T
    limit = 2.5 * np.nanstd(mean)
    ax.imshow(view.image, cmap="gray", vmin=0, vmax=255, extent=extent)
    picture = ax.pcolormesh(*edges, mean, cmap="PuOr", vmin=-limit, vmax=limit, rasterized=True)
    ax.plot(*pixels[~kept].T, ".", markersize=2, color=BLACK, rasterized=True)
    figure.colorbar(picture, ax=ax, label="behind the plane [mm]", shrink=0.9)
    ax.set(xlabel="x [px]", ylabel="y [px]", xlim=extent[:2], ylim=extent[2:], aspect="equal")
    ax.set_title("mean residual of four points; black: left out by the fit")
