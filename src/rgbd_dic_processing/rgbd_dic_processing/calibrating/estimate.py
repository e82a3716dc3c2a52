"""The result of the adjustment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Calibration
from scipy.spatial.transform import Rotation

from .model import LENS, Layout

Array = NDArray[np.float64]


class ImageFit(NamedTuple):
    """How one image fits.

    Attributes:
        residuals_px: (N, 2) found less projected; NaN for a corner that was left out.
        noise_px: standard deviation of a coordinate of a corner, from the residuals and their redundancy.
    """

    residuals_px: Array
    noise_px: float

    @property
    def rms_px(self) -> float:
        """Of the distances, as OpenCV reports reprojection errors."""
        return float(np.sqrt(np.nanmean(np.sum(self.residuals_px**2, axis=1))))


@dataclass(frozen=True)
class Estimate:
    """The adjustment's result.

    Attributes:
        calibration: of both sensors, or of the camera alone.
        names, values, sigmas: of the parameters that people read: `camera.fx` [px] ..., and, for the transform,
            `T_camera_tof.x` ... [m] and `.about_x` ... [rad], turns about the camera's axes. Values are rounded to a
            ten thousandth of their sigma, as digits beyond depend on the number of threads; so is `calibration`.
        poses: (R, t [m]) of X_camera = R X_board + t for each view.
        fits: view's index and sensor -> how that image fits.
        parameters, covariance: of the adjustment, in its own order; `Layout` knows it.
        layout: where what is among the parameters.
    """

    calibration: Calibration
    names: tuple[str, ...]
    values: Array
    sigmas: Array
    poses: tuple[tuple[Array, Array], ...]
    fits: dict[tuple[int, str], ImageFit]
    parameters: Array
    covariance: Array
    layout: Layout = field(repr=False)

    def sigma(self, name: str) -> float:
        return float(self.sigmas[self.names.index(name)])

    def value(self, name: str) -> float:
        return float(self.values[self.names.index(name)])


def make_estimate(layout: Layout, x: Array, covariance: Array, fits: dict, views: int) -> Estimate:
    names, values, variances = [], [], []
    for sensor, model in layout.models.items():
        names += [f"{sensor}.{LENS[index]}" for index in model.free]
        values += list(x[layout.lens[sensor]])
        variances += list(np.diag(covariance)[layout.lens[sensor]])
    if "tof" in layout.models:
        T = x[layout.transform]
        R, t = _inverted(T)
        steps = 1e-6 * np.eye(6)
        by = np.stack([(_difference(T + h, R, t) - _difference(T - h, R, t)) / 2e-6 for h in steps], axis=1)
        names += [f"T_camera_tof.{name}" for name in ("about_x", "about_y", "about_z", "x", "y", "z")]
        values += [*Rotation.from_matrix(R).as_rotvec(), *t]
        variances += list(np.diag(by @ covariance[layout.transform, layout.transform] @ by.T))
    sigmas = np.sqrt(variances)
    values = np.array([round(value, 4 - int(np.floor(np.log10(u)))) for value, u in zip(values, sigmas, strict=True)])
    known = dict(zip(names, map(float, values), strict=True))
    cameras = {}
    for sensor, model in layout.models.items():
        lens = layout.lens_of(x, sensor)
        lens[model.free] = [known[f"{sensor}.{LENS[index]}"] for index in model.free]
        cameras[sensor] = model.camera(lens)
    between = (Rotation.from_rotvec(values[-6:-3]).as_matrix(), values[-3:]) if "tof" in cameras else ()
    return Estimate(
        Calibration(cameras["camera"], cameras.get("tof"), *between),
        tuple(names),
        values,
        sigmas,
        tuple((Rotation.from_rotvec(x[p][:3]).as_matrix(), x[p][3:]) for p in map(layout.pose, range(views))),
        fits,
        x,
        covariance,
        layout,
    )


def _inverted(T: Array) -> tuple[Array, Array]:
    """R, t of the inverse of a transform (rotation vector, translation)."""
    R = Rotation.from_rotvec(T[:3]).as_matrix().T
    return R, -R @ T[3:]


def _difference(T: Array, R: Array, t: Array) -> Array:
    """Turn (about the target's axes) and shift by which the inverse of T differs from R, t."""
    R_now, t_now = _inverted(T)
    return np.concatenate([Rotation.from_matrix(R_now @ R.T).as_rotvec(), t_now - t])
