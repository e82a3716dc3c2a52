"""Figures 4.8 to 4.14 and 4.17: the regions on the image, the ToF cloud and its plane, the panel's shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import pixel_rays
from rgbd_dic_acquisition.simulator.laboratory import Laboratory

from ....core.plane import fit_plane
from ....core.regions import inside
from ....core.regions_file import load_regions
from ....core.settings import PlaneSettings
from ....report.drawing import BLUE, GREEN, ORANGE, SKY, VERMILION, Picture, appearance, new_figure, save
from ..chapter import MAPPED, METHODS, Chapter4
from ..regions import REGIONS, regions_of, usual_region
from ..scenes import open_laboratory

Array = NDArray[np.float64]

DRAWN = 6000  # points of a cloud


def draw(data: Chapter4, run_folder: Path, into: Path) -> list[Picture]:
    """Write all of them."""
    field, seed = MAPPED
    lab = open_laboratory(data.scope.laboratory(field, seed))
    regions_path = run_folder / data.example / "regions.yaml"
    widest_s = data.histories[field, seed, METHODS[0], usual_region(field)].widest_s
    with appearance():
        return [_image(lab, regions_path, into), _cloud(lab, regions_path, into), _shape(lab, widest_s, into)]


def _image(lab: Laboratory, regions_path: Path, into: Path) -> Picture:
    """Figures 4.8, 4.12, 4.13 and 4.17."""
    figure = new_figure(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    image = lab.image(lab.reference_s, 0)
    drawn = load_regions(regions_path)
    for ax in (left, right):
        ax.imshow(image, cmap="gray", vmin=0, vmax=255)
        ax.set_xlabel("x [px]")
    left.set_ylabel("y [px]")
    _polygon(left, drawn.panel, VERMILION, "-", "panel, whole")
    for region, color, line in zip(REGIONS[:2], (ORANGE, SKY), ("--", ":"), strict=True):
        (polygon,) = regions_of(lab, regions_path, region).fixed
        _polygon(left, polygon, color, line, region)
    left.set_title("regions for the motion", loc="left")
    left.legend(loc="lower left", labelcolor="white", fontsize=8)
    crack = drawn.crack
    for polygon, color, line, name in (
        (crack.left, SKY, "-", "left zone"),
        (crack.right, ORANGE, "--", "right zone"),
    ):
        _polygon(right, polygon, color, line, name)
    ends = crack.point + np.outer((-1, 1), crack.direction) * np.ptp(crack.left[:, 1])
    right.plot(*ends.T, color=VERMILION, linewidth=1, label="crack")
    reach = 1.1 * np.ptp(crack.left[:, 1])
    right.set_xlim(crack.point[0] - reach, crack.point[0] + reach)
    right.set_ylim(crack.point[1] + reach, crack.point[1] - reach)
    right.set_title("measuring zones", loc="left")
    right.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    caption = (
        "Figures 4.8, 4.12, 4.13 and 4.17: the first image with the regions that the motion is estimated from, and the "
        "measuring zones beside the crack."
    )
    return save(figure, into / "chapter4_image.png", caption, "The panel with its regions and zones.")


def _cloud(lab: Laboratory, regions_path: Path, into: Path) -> Picture:
    """Figures 4.9 to 4.11: the cloud of the first ToF frame in the camera's frame."""
    first = next(exposure for exposure in lab.exposures() if exposure.sensor == "tof")
    depth_m = lab.depth(first.time_s, first.index).depth_m
    calibration = lab.calibration
    valid = np.isfinite(depth_m)
    points = (pixel_rays(calibration.tof)[valid] * depth_m[valid, None]) @ calibration.R_camera_tof.T
    points = points + calibration.t_camera_tof
    seen = calibration.camera.distort(calibration.camera.project(points))
    chosen = inside(load_regions(regions_path).panel, seen)
    plane, _, rms_m = fit_plane(points[chosen], PlaneSettings())
    figure = new_figure(9.0, 3.4)
    whole, front, side = figure.subplots(1, 3)
    for ax, cloud, color in ((whole, points[~chosen], BLUE), (whole, points[chosen], VERMILION)):
        x, _, z = _some(cloud).T
        ax.plot(x, z, ".", color=color, markersize=1)
    whole.set_title("from above: cloud, selection red", loc="left")
    x, y, z = _some(points[chosen]).T
    shown = front.scatter(x, y, c=1e3 * z, s=2, cmap="viridis", linewidths=0)
    front.set_aspect("equal")
    front.invert_yaxis()
    front.set_title("selected points", loc="left")
    figure.colorbar(shown, ax=front, label="z [mm]", location="bottom", shrink=0.9)
    side.plot(x, 1e3 * z, ".", color=VERMILION, markersize=1.5)
    on_plane = plane.depths(np.column_stack([x / z, y / z, np.ones_like(z)]))
    side.plot(x, 1e3 * on_plane, ".", color=GREEN, markersize=1.5)
    side.set_title(f"plane (green), RMS {1e3 * rms_m:.2f} mm", loc="left")
    for ax, label in ((whole, "z [m]"), (front, "y [m]"), (side, "z [mm]")):
        ax.set_xlabel("x [m]")
        ax.set_ylabel(label)
    caption = (
        "Figures 4.9 to 4.11: the first ToF frame in the camera's frame, the points that Eq. 4.1 puts inside the "
        "panel, and the plane through them."
    )
    return save(figure, into / "chapter4_cloud.png", caption, "The ToF cloud, the selection and the plane.")


def _shape(lab: Laboratory, time_s: float, into: Path) -> Picture:
    """Figure 4.14: the panel's shape, from the truth."""
    figure = new_figure(9.0, 2.6)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    axes[0].invert_yaxis()
    panel = lab.settings.panel
    x = np.linspace(-panel.width_m, panel.width_m, 240) / 2
    grid = np.stack(np.meshgrid(x, np.linspace(-panel.height_m, panel.height_m, 60) / 2), axis=-1)
    moved = 1e3 * lab.displacement(grid[..., 0], grid[..., 1], time_s)
    extent = [-panel.width_m / 2, panel.width_m / 2, panel.height_m / 2, -panel.height_m / 2]
    for ax, axis in zip(axes, range(3), strict=True):
        shown = ax.imshow(moved[..., axis], extent=extent, cmap="viridis")
        ax.set_title(f"true {'xyz'[axis]} displacement", loc="left")
        ax.set_xlabel("x [m]")
        figure.colorbar(shown, ax=ax, label="[mm]", location="bottom", shrink=0.9)
    axes[0].set_ylabel("y [m]")
    caption = (
        f"Figure 4.14: how the panel has moved at its widest opening ({time_s:.2f} s) [mm], from the truth; z is into "
        "the wall. The static bow is not part of it."
    )
    return save(figure, into / "chapter4_shape.png", caption, "True displacement of the panel in x, y and z.")


def _polygon(ax: Axes, corners_px: Array, color: str, line: str, name: str) -> None:
    closed = np.vstack([corners_px, corners_px[:1]])
    ax.plot(*closed.T, color=color, linestyle=line, linewidth=1.5, label=name)


def _some(points: Array) -> Array:
    chosen = np.random.default_rng(0).permutation(len(points))[:DRAWN]
    return points[chosen]
