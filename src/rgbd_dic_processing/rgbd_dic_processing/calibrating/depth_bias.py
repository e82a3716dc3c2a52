"""What the ToF sensor measures too much or too little, against the boards' planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import pixel_rays
from rgbd_dic_acquisition.errors import CalibrationError
from scipy.spatial.transform import Rotation

from .board import Board
from .estimate import Estimate
from .views import BoardView

Array = NDArray[np.float64]

GROSS = 4.0  # pixels beyond so many robust standard deviations of their board are left out
LEAST_PIXELS = 50
LIGHT, DARK = 0.75, 0.35  # of the way from the dark to the light grey level: pixels on one square alone
MOST_FOR_DERIVATIVES = 400


@dataclass(frozen=True)
class DepthBias:
    """Measured less true range along the ToF sensor's rays, on the light parts of the boards [m].

    Attributes:
        bias_m, u_bias_m: mean over the boards, and its standard uncertainty with that of the calibration.
        slope, u_slope: change of the bias with range [m/m]; NaN from boards at one range.
        noise_m: standard deviation of a pixel within a board.
        dark_m, u_dark_m: how much farther dark parts seem than light ones; NaN if none are large enough.
        names, range_m, board_bias_m, u_board_m: (N,) of each board: name, mean true range, bias and its standard
            uncertainty from noise alone.
    """

    bias_m: float
    u_bias_m: float
    slope: float
    u_slope: float
    noise_m: float
    dark_m: float
    u_dark_m: float
    names: tuple[str, ...]
    range_m: Array
    board_bias_m: Array
    u_board_m: Array


class _Sample(NamedTuple):
    """One board's part: mean true range [m], and measured less true range [m] of its light and dark pixels."""

    view: int
    name: str
    range_m: float
    light_m: Array
    dark_m: Array
    pixels: NDArray[np.bool_]  # (rows, cols) the light ones


def depth_bias(
    views: Sequence[BoardView], board: Board, estimate: Estimate, scale_error: float
) -> tuple[DepthBias | None, list[str]]:
    """The bias from all views with depth (None if fewer than three can be used), and what was left out and why.

    Raises:
        CalibrationError: depth and boards differ by more than `scale_error` (relative): a wrong size of the squares,
            swapped sensors, or depth of another moment.
    """
    rays = pixel_rays(estimate.calibration.tof)
    length = np.linalg.norm(rays, axis=-1)
    used: list[_Sample] = []
    notes: list[str] = []
    for index, view in enumerate(views):
        if view.depth_m is None or not (view.tof and view.camera):
            continue
        inside, predicted = _on_board(board, rays, *_pose_in_tof(estimate.parameters, estimate, index))
        valid = inside & np.isfinite(view.depth_m)
        light, dark = (valid & part for part in _light_and_dark(view.images["tof"], inside))
        if light.sum() < LEAST_PIXELS:
            notes.append(f"{view.name}: depth of only {light.sum()} pixels on light parts of the board")
            continue
        error = (view.depth_m - predicted) * length
        pixels = _within(error, light)
        range_m = float(np.mean((predicted * length)[pixels]))
        used.append(_Sample(index, view.name, range_m, error[pixels], error[_within(error, dark)], pixels))
    if len(used) < 3:
        return None, [*notes, f"no range bias: {len(used)} boards seen by both sensors have depth, three are needed"]
    ranges = np.array([sample.range_m for sample in used])
    biases, noises = (np.array([of(sample.light_m) for sample in used]) for of in (np.mean, np.std))
    ratio = 1 + np.median(biases / ranges)
    if abs(ratio - 1) > scale_error:
        raise CalibrationError(
            f"the ToF sensor measures {ratio:.3f} times the range at which the boards must be, if their squares are of "
            f"{board.settings.square_m * 1e3:g} mm: are they of {board.settings.square_m * ratio * 1e3:.1f} mm? Else "
            "the sensors are swapped, or the depth is of another moment"
        )
    by_parameters = np.mean([_derivatives(estimate, s.view, board, s.pixels) for s in used], axis=0)
    scatter = np.std(biases, ddof=1)
    u_bias = np.sqrt(by_parameters @ estimate.covariance @ by_parameters + scatter**2 / len(used))
    slope, u_slope = _trend(ranges, biases)
    steps = np.array([s.dark_m.mean() - s.light_m.mean() for s in used if len(s.dark_m) >= LEAST_PIXELS])
    several = len(steps) > 2
    bias = DepthBias(
        float(np.mean(biases)),
        float(u_bias),
        slope,
        u_slope,
        float(np.sqrt(np.mean(noises**2))),
        float(np.mean(steps)) if several else np.nan,
        float(np.std(steps, ddof=1) / np.sqrt(len(steps))) if several else np.nan,
        tuple(sample.name for sample in used),
        ranges,
        biases,
        noises / np.sqrt([len(sample.light_m) for sample in used]),
    )
    return bias, notes


def _pose_in_tof(parameters: Array, estimate: Estimate, view: int) -> tuple[Array, Array]:
    """R, t [m] of X_tof = R X_board + t."""
    T, pose = parameters[estimate.layout.transform], parameters[estimate.layout.pose(view)]
    R = Rotation.from_rotvec(T[:3])
    return (R * Rotation.from_rotvec(pose[:3])).as_matrix(), R.apply(pose[3:]) + T[3:]


def _on_board(board: Board, rays: Array, R: Array, t: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which rays (..., 3) end on the squares, half a square from the edge, and the board's depth on all of them [m]."""
    with np.errstate(divide="ignore"):
        depth = (R[:, 2] @ t) / (rays @ R[:, 2])
    at = (rays * depth[..., None] - t) @ R
    s = board.settings
    limits = 0.5 * s.square_m * np.array([s.cols - 1, s.rows - 1])
    return (depth > 0) & np.all(np.abs(at[..., :2]) < limits, axis=-1), depth


def _light_and_dark(image: NDArray, inside: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    if not inside.any():
        return inside, inside
    low, high = np.percentile(image[inside], [5, 95])
    level = (image.astype(float) - low) / max(high - low, 1.0)
    return level > LIGHT, level < DARK


def _within(error: Array, part: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The pixels of a part without gross errors, such as flying pixels."""
    if not part.any():
        return part
    middle = np.median(error[part])
    scale = 1.4826 * np.median(np.abs(error[part] - middle))
    return part & (np.abs(np.where(part, error, middle) - middle) <= GROSS * max(scale, 1e-4))


def _derivatives(estimate: Estimate, view: int, board: Board, kept: NDArray[np.bool_]) -> Array:
    """Of a board's bias by all parameters: the predicted range is their function, the measured one is not."""
    layout, x = estimate.layout, estimate.parameters
    rows, cols = np.nonzero(kept)
    some = np.linspace(0, len(rows) - 1, min(len(rows), MOST_FOR_DERIVATIVES)).astype(int)
    pixels = np.stack([cols[some], rows[some]], axis=-1).astype(float)

    def bias(x: Array) -> float:
        camera = layout.models["tof"].camera(layout.lens_of(x, "tof"))
        rays = camera.rays(camera.undistort(pixels))
        _, depth = _on_board(board, rays, *_pose_in_tof(x, estimate, view))
        return -float(np.mean(depth * np.linalg.norm(rays, axis=-1)))

    gradient = np.zeros(layout.size)
    for place in (layout.lens["tof"], layout.transform, layout.pose(view)):
        for j in range(place.start, place.stop):
            step = np.zeros(layout.size)
            step[j] = 0.5 * np.sqrt(estimate.covariance[j, j])
            gradient[j] = (bias(x + step) - bias(x - step)) / (2 * step[j])
    return gradient


def _trend(ranges: Array, biases: Array) -> tuple[float, float]:
    """Slope of the bias over range, and its standard uncertainty from the scatter about the line."""
    if len(ranges) < 4 or np.ptp(ranges) < 0.1 * ranges.mean():
        return np.nan, np.nan
    (slope, _), covariance = np.polyfit(ranges, biases, 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))
