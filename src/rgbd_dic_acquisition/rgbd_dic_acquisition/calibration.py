"""Intrinsics, distortion and extrinsics of the two sensors; the file `calibration.yaml` (docs/files.md)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from .columns import columns
from .errors import CalibrationError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with radial distortion of two orders (thesis 4.2.2; Brown's model, tangential part off).

    With (x, y) = (X/Z, Y/Z) and r^2 = x^2 + y^2, the pixel is
    u = fx x (1 + k1 r^2 + k2 r^4) + cx, v = fy y (1 + k1 r^2 + k2 r^4) + cy;
    pixel (0, 0) is the centre of the first pixel. All lengths are pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0

    def __post_init__(self) -> None:
        values = np.array([self.fx, self.fy, self.cx, self.cy, self.k1, self.k2], float)
        if self.width < 1 or self.height < 1:
            raise CalibrationError(f"image size {self.width} x {self.height}: must be at least 1 x 1 pixels")
        if not np.all(np.isfinite(values)) or self.fx <= 0 or self.fy <= 0:
            raise CalibrationError(
                f"uncalibrated camera: fx = {self.fx}, fy = {self.fy}, cx = {self.cx}, cy = {self.cy}, "
                f"k1 = {self.k1}, k2 = {self.k2}; the focal lengths must be above 0 and all values finite. "
                "Calibrate the camera, or give a calibration.yaml"
            )

    @cached_property
    def matrix(self) -> Array:
        """K, (3, 3), upper triangular (the thesis prints its transpose, Eq. 2.4)."""
        return _constant([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    @cached_property
    def inverse_matrix(self) -> Array:
        """The inverse of K."""
        return _constant(np.linalg.inv(self.matrix))

    def distort(self, points_px: Array) -> Array:
        """Ideal pinhole pixels (N, 2) -> pixels of the raw image (N, 2)."""
        if self.k1 == 0.0 and self.k2 == 0.0:
            return np.array(points_px, float)
        points = np.asarray(points_px, float)
        x, y = (points[..., 0] - self.cx) / self.fx, (points[..., 1] - self.cy) / self.fy
        r2 = x * x + y * y
        factor = 1 + r2 * (self.k1 + self.k2 * r2)
        return columns(self.cx + self.fx * x * factor, self.cy + self.fy * y * factor)

    def undistort(self, points_px: Array) -> Array:
        """Raw pixels (N, 2) -> ideal pinhole pixels (N, 2); NaN stays NaN.

        Newton's method on the radius, r (1 + k1 r^2 + k2 r^4) = r_d, to the last bits of a double. A point
        beyond the radius at which the model folds back has no ideal pixel: NaN.
        """
        if self.k1 == 0.0 and self.k2 == 0.0:
            return np.array(points_px, float)
        points = np.asarray(points_px, float)
        x, y = (points[..., 0] - self.cx) / self.fx, (points[..., 1] - self.cy) / self.fy
        distorted = np.sqrt(x * x + y * y)
        radius = distorted
        with np.errstate(all="ignore"):
            for _ in range(20):
                r2 = radius * radius
                slope = 1 + r2 * (3 * self.k1 + 5 * self.k2 * r2)
                step = (radius * (1 + r2 * (self.k1 + self.k2 * r2)) - distorted) / slope
                radius = radius - step
                if not np.any(np.abs(step) > 1e-9):  # what is left is of the order of its square
                    break
            r2 = radius * radius
            folded = (1 + r2 * (3 * self.k1 + 5 * self.k2 * r2)) <= 0
            residual = np.abs(radius * (1 + r2 * (self.k1 + self.k2 * r2)) - distorted)
            bad = folded | (residual > 1e-9) | (radius < 0)
            factor = np.where(bad, np.nan, np.where(distorted > 0, radius / distorted, 1.0))
        return columns(self.cx + self.fx * x * factor, self.cy + self.fy * y * factor)

    def rays(self, points_px: Array) -> Array:
        """Ideal pinhole pixels (N, 2) -> directions (N, 3) in the optical frame, z = 1 (Eq. 2.1: [g_x g_y 1])."""
        points = np.asarray(points_px, float)
        x = (points[..., 0] - self.cx) / self.fx
        y = (points[..., 1] - self.cy) / self.fy
        return columns(x, y, np.ones_like(x))

    def project(self, points_m: Array) -> Array:
        """Points (N, 3) in the optical frame [m] -> ideal pinhole pixels (N, 2); NaN behind the camera."""
        points = np.asarray(points_m, float)
        z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
        x, y = points[..., 0] / z, points[..., 1] / z
        return columns(self.fx * x + self.cx, self.fy * y + self.cy)

    @classmethod
    def from_camera_info(cls, info: Any) -> Camera:
        """From a sensor_msgs/CameraInfo (or an object with its fields).

        Raises:
            CalibrationError: if it is uncalibrated (K[0] == 0) or has a distortion that this model lacks.
        """
        k, d = np.asarray(info.k, float), [float(value) for value in info.d]
        if k.shape != (9,) or k[0] == 0:
            raise CalibrationError(
                f"CameraInfo of frame '{info.header.frame_id}' is uncalibrated (K[0] == 0): "
                "calibrate the camera, or give a calibration.yaml"
            )
        if info.distortion_model not in ("plumb_bob", "rational_polynomial", ""):
            raise CalibrationError(
                f"CameraInfo has distortion model '{info.distortion_model}'; supported is 'plumb_bob' with radial "
                "terms of two orders"
            )
        unsupported = [value for index, value in enumerate(d) if index > 1 and abs(value) > 0]
        if unsupported:
            raise CalibrationError(
                f"CameraInfo has distortion coefficients {d}: only k1 and k2 are supported, the others must be 0"
            )
        k1, k2 = [*d, 0.0, 0.0][:2]
        return cls(int(info.width), int(info.height), k[0], k[4], k[2], k[5], k1, k2)

    def agrees_with(self, other: Camera) -> bool:
        """Whether the other camera has the same numbers, to a millionth."""
        mine, theirs = (np.array([*dataclasses.astuple(camera)], float) for camera in (self, other))
        return bool(np.allclose(mine, theirs, rtol=1e-6, atol=1e-6))

    def scaled_to(self, width: int, height: int) -> Camera:
        """The same lens with another number of pixels (pixel centres at whole numbers)."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )


@dataclass(frozen=True)
class Calibration:
    """Both sensors and X_camera = R_camera_tof X_tof + t_camera_tof [m].

    `tof` is None where the depth comes as point clouds, which need the extrinsics alone, or not at all.
    """

    camera: Camera
    tof: Camera | None = None
    R_camera_tof: Array = field(default_factory=lambda: np.eye(3))
    t_camera_tof: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        rotation, translation = np.asarray(self.R_camera_tof, float), np.asarray(self.t_camera_tof, float)
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise CalibrationError(f"T_camera_tof.rotation is not a rotation matrix: {rotation.tolist()}")
        if np.linalg.det(rotation) < 0:
            raise CalibrationError("T_camera_tof.rotation mirrors space (determinant -1): swap an axis")
        if translation.shape != (3,) or not np.all(np.isfinite(translation)):
            raise CalibrationError(f"T_camera_tof.translation_m must be three numbers: {translation.tolist()}")


def _constant(values: Any) -> Array:
    array = np.array(values, float)
    array.setflags(write=False)
    return array


def pixel_rays(camera: Camera) -> Array:
    """Rays (rows, cols, 3), z = 1, of all raw pixels of a camera."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float)
    return camera.rays(camera.undistort(pixels)).reshape(camera.height, camera.width, 3)


def points_from_depth(camera: Camera, depth_m: NDArray[np.floating]) -> Array:
    """Points (rows * cols, 3) [m] of a depth image (rows, cols) [m] in the sensor's frame; NaN where there is none."""
    return (pixel_rays(camera) * np.asarray(depth_m, float)[..., None]).reshape(-1, 3)


def intrinsics_of(shape: tuple[int, ...], camera: Camera | None) -> Camera:
    """The intrinsics for depth of (rows, cols) pixels.

    Raises:
        CalibrationError: there are none, or they are of another size.
    """
    if camera is None:
        raise CalibrationError("the ToF camera tells no intrinsics: give a calibration.yaml with an entry 'tof'")
    if (camera.height, camera.width) != shape:
        raise CalibrationError(
            f"depth of {shape[1]} x {shape[0]} pixels has intrinsics of {camera.width} x {camera.height}: "
            "give the calibration.yaml of this ToF camera"
        )
    return camera


def load_calibration(path: Path | str) -> Calibration:
    """Read calibration.yaml.

    Raises:
        CalibrationError: naming the file, the entry and what is wrong with it.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CalibrationError(f"cannot read calibration {path}: {error}") from error
    if not isinstance(content, dict) or "camera" not in content:
        raise CalibrationError(f"{path}: needs an entry 'camera' (see docs/files.md)")
    try:
        camera = _camera_from(content["camera"])
        tof = _camera_from(content["tof"]) if content.get("tof") else None
        if tof is None and "T_camera_tof" not in content:
            return Calibration(camera)
        extrinsics = content["T_camera_tof"]
        return Calibration(
            camera,
            tof,
            _orthonormal(np.array(extrinsics["rotation"], float)),
            np.array(extrinsics["translation_m"], float),
        )
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CalibrationError(f"{path}: missing or malformed entry {error} (see docs/files.md)") from error


def save_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write calibration.yaml, every number to its last bit."""
    content: dict[str, Any] = {"camera": _camera_to(calibration.camera)}
    if calibration.tof is not None:
        content["tof"] = _camera_to(calibration.tof)
    moved = not np.array_equal(calibration.R_camera_tof, np.eye(3)) or np.any(calibration.t_camera_tof)
    if calibration.tof is not None or moved:
        content["T_camera_tof"] = {
            "rotation": np.asarray(calibration.R_camera_tof, float).tolist(),
            "translation_m": np.asarray(calibration.t_camera_tof, float).tolist(),
        }
    text = (
        "# Calibration of the two sensors (docs/files.md). Pixels; radial distortion k1, k2 without unit.\n"
        "# T_camera_tof: X_camera = rotation X_tof + translation_m.\n"
    )
    Path(path).write_text(text + yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _orthonormal(rotation: Array) -> Array:
    """The rotation nearest to a matrix printed with few digits (thesis, Table 4.5); others pass to the check."""
    if rotation.shape != (3, 3) or not np.all(np.isfinite(rotation)):
        return rotation
    u, singular, vt = np.linalg.svd(rotation)
    return u @ vt if np.allclose(singular, 1, atol=1e-2) else rotation


def _camera_from(entry: dict[str, Any]) -> Camera:
    image_size = entry["image_size_px"]
    focal, centre = entry["focal_length_px"], entry["principal_point_px"]
    k1, k2 = entry.get("radial_distortion", [0.0, 0.0])
    return Camera(
        width=int(image_size[0]),
        height=int(image_size[1]),
        fx=float(focal[0]),
        fy=float(focal[1]),
        cx=float(centre[0]),
        cy=float(centre[1]),
        k1=float(k1),
        k2=float(k2),
    )


def _camera_to(camera: Camera) -> dict[str, Any]:
    return {
        "image_size_px": [camera.width, camera.height],
        "focal_length_px": [float(camera.fx), float(camera.fy)],
        "principal_point_px": [float(camera.cx), float(camera.cy)],
        "radial_distortion": [float(camera.k1), float(camera.k2)],
    }
