"""The panel's plane in the camera frame, from one ToF frame (thesis 4.3.1)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Calibration, Camera, pixel_rays
from rgbd_dic_acquisition.errors import CalibrationError, ImageError, MeasurementError

from .curvature import Curvature, fit_curvature
from .geometry import Plane, apply_homography
from .msac import msac
from .plane_uncertainty import block_covariance, systematic_covariance
from .regions import Regions, polygon_mask
from .settings import PlaneSettings
from .stamps import Place, Stretches
from .status import FrameStatus

Array = NDArray[np.float64]

MSAC_POINTS = 1000  # points of the sample consensus; the fit after it takes all
MSAC_TRIALS = 200
LEAST_SIGMA_M = 1e-5  # no depth is believed to be better than this, not even a constant plane's
COARSE = 8  # distance of the pixels of a depth image that tell where in it the panel is
MARGIN = 3 * COARSE  # pixels around those that are on it
NO_PIXEL = "the ToF frame has no valid pixel"
MAX_WAITING = 32  # ToF frames that wait for the next image before the oldest is given up
VIEW_LIMIT_S = 0.25  # a ToF frame farther than this from every image has no view to carry the panel region into


@dataclass(frozen=True)
class PlaneEstimate:
    """The plane of one ToF frame, or why there is none.

    plane: its covariance is what other frames do not share: noise, and the shape of the panel as it is seen.
    systematic: (4, 4), covariance of the plane from the sensor's accuracy, which frames from the same place share; the
    two add up to how far the plane is from the true one. None if not known.
    step_m, u_step_m: how far the panel's right side lies behind its left side at the crack, along the normal, and the
    standard uncertainty of that; from a plane through each side. NaN without a crack or with too few points.
    curvature: how the panel is bowed about the plane; None if not known.
    """

    stamp_ns: int
    status: FrameStatus
    reason: str = ""
    plane: Plane | None = None
    points: int = 0
    inliers: int = 0
    residual_rms_m: float = math.nan
    step_m: float = math.nan
    u_step_m: float = math.nan
    systematic: Array | None = None
    curvature: Curvature | None = None

    @property
    def accuracy(self) -> float:
        """Relative standard uncertainty of the distance that all frames share; 0 if not known."""
        if self.plane is None or self.systematic is None:
            return 0.0
        return math.sqrt(self.systematic[3, 3]) / -self.plane.d


def cloud_of_depth(depth_m: NDArray[np.float32], tof: Camera) -> Array:
    """Points (N, 3) [m] in the frame of a ToF sensor, from its depth image (rows, cols) [m], NaN invalid.

    Raises:
        ImageError: if it is not of the calibrated size.
    """
    _require_size(depth_m, tof)
    return _cloud(depth_m, pixel_rays(tof))


def _require_size(depth_m: NDArray[np.float32], tof: Camera) -> None:
    if depth_m.shape != (tof.height, tof.width):
        raise ImageError(
            f"depth image is {depth_m.shape[1]} x {depth_m.shape[0]} px, calibrated are {tof.width} x {tof.height} px"
        )


def _cloud(depth_m: NDArray[np.float32], rays: Array) -> Array:
    """Points (N, 3) of a depth image, or of a part of one, and the rays (rows, cols, 3) of its pixels."""
    valid = np.isfinite(depth_m)
    return rays[valid] * depth_m[valid, None].astype(float)


def fit_plane(points_m: Array, settings: PlaneSettings) -> tuple[Plane, NDArray[np.bool_], float]:
    """Robust plane through points (N, 3) [m] of a sensor whose noise lies along z.

    The plane is pi . X = 1, so 1/z = pi . g with g = X/z: linear in pi. The residual (1/z - pi . g) z^2 is the depth
    error to first order. Sample consensus finds the start; Tukey's biweight, scaled by the median absolute residual,
    the plane through all points.

    Returns:
        The plane with its covariance, the mask (N,) of the points that kept weight, the RMS of their residuals [m].

    Raises:
        MeasurementError: if too few points lie on one plane, or the residual is larger than believed.
    """
    z = points_m[:, 2]
    rays, inverse, scale = points_m / z[:, None], 1 / z, z**2

    def solve(chosen: NDArray[np.intp] | slice, weights: Array | float = 1.0) -> Array | None:
        weighted = rays[chosen] * (weights * scale[chosen] ** 2)[:, None]
        normal_matrix = weighted.T @ rays[chosen]
        if np.linalg.cond(normal_matrix) > 1e14:
            return None
        solution = np.linalg.solve(normal_matrix, weighted.T @ inverse[chosen])
        return solution if solution[2] > 0 else None

    def depth_errors(pi: Array) -> Array:
        return np.abs(inverse - rays @ pi) * scale

    sample = np.linspace(0, len(z) - 1, min(len(z), MSAC_POINTS)).astype(int)
    pi, _ = msac(
        len(sample),
        3,
        lambda chosen: solve(sample[chosen]),
        lambda model: depth_errors(model)[sample],
        settings.max_residual_m,
        MSAC_TRIALS,
    )
    weights, errors = np.ones(len(z)), depth_errors(pi)
    for _ in range(20):
        near = errors <= settings.max_residual_m
        sigma = max(1.4826 * float(np.median(errors[near])), LEAST_SIGMA_M)
        weights = np.where(near, np.clip(1 - (errors / (4.685 * sigma)) ** 2, 0, None) ** 2, 0)
        refined = solve(slice(None), weights)
        if refined is None:
            raise MeasurementError("the ToF points do not span a plane")
        before, pi, errors = errors, refined, depth_errors(refined)
        if np.abs(errors - before).max() < 1e-7:
            break
    inliers = weights > 0
    share = inliers.mean()
    if share < settings.min_inliers:
        raise MeasurementError(
            f"only {share:.0%} of {len(z)} ToF points on the panel lie on one plane "
            f"(at least {settings.min_inliers:.0%} needed)"
        )
    residuals = (inverse - rays @ pi) * scale
    rms = float(np.sqrt(np.mean(residuals[inliers] ** 2)))
    if rms > settings.max_residual_m:
        raise MeasurementError(f"plane residual {rms * 1e3:.1f} mm RMS is above {settings.max_residual_m * 1e3:.1f} mm")
    # Huber 1981, 6.3: the scores of an M-estimate with psi(r) = r w(r), here Tukey's, and their derivative
    u2 = np.square(residuals[inliers] / (4.685 * sigma))
    slope = np.mean((1 - u2) * (1 - 5 * u2))
    design = rays[inliers] * scale[inliers, None]
    scores = design * (weights * residuals)[inliers, None]
    information = design.T @ design
    covariance = block_covariance(rays[inliers], scores, slope * information)
    covariance += LEAST_SIGMA_M**2 * np.linalg.inv(information)
    return Plane.from_inverse_depth(pi, covariance), inliers, rms


class PanelPlane:
    """Fits the plane of each ToF frame inside the panel region, carried into the current view.

    A ToF frame waits for the first image at or after it, so that the view nearest in time is known; which one it
    uses depends on the stamps alone. tof_delay_ns: known delay of the ToF stamps, subtracted from them.
    """

    def __init__(self, calibration: Calibration, regions: Regions, settings: PlaneSettings, tof_delay_ns: int = 0):
        if calibration.tof is None:
            raise CalibrationError("the calibration has no 'tof': planes need its intrinsics and T_camera_tof")
        self._calibration = calibration
        self._settings = settings
        self._tof_delay_ns = tof_delay_ns
        self._rays = None if calibration.tof is None else pixel_rays(calibration.tof)
        self._of_depths, self._of_views = Stretches(), Stretches()
        self._waiting: deque[tuple[Place, Callable[[Array], Array] | None, str]] = deque()
        self._views: deque[tuple[Place, Array | None]] = deque(maxlen=64)
        self.take_regions(regions)

    def take_regions(self, regions: Regions) -> None:
        """Other regions, on another image, hold for the views to come; the ToF frames that wait go by them too."""
        camera = self._calibration.camera
        self._crack, self._mask = regions.crack, polygon_mask(regions.panel, camera.width, camera.height)
        self._views.clear()

    def add_depth(self, stamp_ns: int, depth_m: NDArray[np.float32] | None, reason: str = "") -> list[PlaneEstimate]:
        """A ToF depth image (rows, cols) [m], NaN invalid; None with a reason if it could not be read.

        Raises:
            CalibrationError: if the calibration has no ToF sensor.
        """
        if self._rays is None:
            raise CalibrationError("the calibration has no 'tof': depth images need its intrinsics and extrinsics")
        if depth_m is None:
            return self._add(stamp_ns, None, reason)
        try:
            _require_size(depth_m, self._calibration.tof)
        except ImageError as error:
            return self._add(stamp_ns, None, str(error))
        reason = reason if np.isfinite(depth_m).any() else NO_PIXEL
        return self._add(stamp_ns, lambda view: self._near_panel(depth_m, view), reason)

    def add_points(self, stamp_ns: int, points_m: Array | None, reason: str = "") -> list[PlaneEstimate]:
        """A ToF point cloud (N, 3) in the ToF frame [m]; rows with NaN are dropped."""
        if points_m is None:
            return self._add(stamp_ns, None, reason)
        finite = points_m[np.isfinite(points_m).all(axis=1)]
        return self._add(stamp_ns, lambda _: finite, reason if len(finite) else NO_PIXEL)

    def _add(self, stamp_ns: int, cloud: Callable[[Array], Array] | None, reason: str) -> list[PlaneEstimate]:
        """cloud: view -> points (N, 3) in the ToF frame [m] that hold all those on the panel."""
        self._waiting.append((self._of_depths.place(stamp_ns - self._tof_delay_ns), cloud, reason))
        if len(self._waiting) > MAX_WAITING:
            (_, stamp_ns), _, _ = self._waiting.popleft()
            return [PlaneEstimate(stamp_ns, FrameStatus.NO_PLANE, "no image came after it"), *self._settle()]
        return self._settle()

    def add_view(self, stamp_ns: int, homography: Array | None) -> list[PlaneEstimate]:
        """The homography reference -> image (ideal pixels) of an image; None if the image was lost."""
        self._views.append((self._of_views.place(stamp_ns), homography))
        return self._settle()

    def flush(self) -> list[PlaneEstimate]:
        """No more images come: settle all frames with the views that are there."""
        return self._settle(all_of_them=True)

    def _settle(self, all_of_them: bool = False) -> list[PlaneEstimate]:
        estimates = []
        while self._waiting and (all_of_them or self._of_views.newest >= self._waiting[0][0]):
            estimates.append(self._estimate(*self._waiting.popleft()))
        return estimates

    def _estimate(self, place: Place, cloud: Callable[[Array], Array] | None, reason: str) -> PlaneEstimate:
        stretch, stamp_ns = place
        if reason or cloud is None:
            return PlaneEstimate(stamp_ns, FrameStatus.BAD_DEPTH, reason or "no depth")
        views = [(abs(view_ns - stamp_ns), view) for (of, view_ns), view in self._views if of == stretch]
        away_ns, view = min(views, key=lambda entry: entry[0], default=(math.inf, None))
        if away_ns > VIEW_LIMIT_S * 1e9 or view is None:
            return PlaneEstimate(stamp_ns, FrameStatus.NO_PLANE, "no image near it in which the panel was found")
        on_panel, reference_px = self.select(cloud(view), view)
        fewer = slice(None, None, math.ceil(max(len(on_panel), 1) / self._settings.max_points))
        on_panel, reference_px = on_panel[fewer], reference_px[fewer]
        if len(on_panel) < self._settings.min_points:
            return PlaneEstimate(
                stamp_ns,
                FrameStatus.NO_PLANE,
                f"{len(on_panel)} ToF points on the panel, at least {self._settings.min_points} needed",
                points=len(on_panel),
            )
        try:
            plane, inliers, rms = fit_plane(on_panel, self._settings)
        except MeasurementError as error:
            return PlaneEstimate(stamp_ns, FrameStatus.NO_PLANE, str(error), points=len(on_panel))
        step_m, u_step_m = self._step(on_panel, reference_px, plane)
        sensor_m = self._calibration.t_camera_tof
        return PlaneEstimate(
            stamp_ns,
            FrameStatus.OK,
            "",
            plane,
            len(on_panel),
            int(inliers.sum()),
            rms,
            step_m,
            u_step_m,
            systematic_covariance(on_panel[inliers], plane, sensor_m, self._settings),
            fit_curvature(on_panel, plane, sensor_m, self._settings) if self._settings.curvature else None,
        )

    def _step(self, points_m: Array, reference_px: Array, plane: Plane) -> tuple[float, float]:
        """The step of `PlaneEstimate`: from a plane through the points on each side of the crack's line."""
        if self._crack is None or not self._settings.step:
            return math.nan, math.nan
        right = self._crack.beyond(reference_px)
        at_crack = points_m[np.argsort(np.hypot(*(reference_px - self._crack.point).T))[:9]].mean(axis=0)
        offsets, variance = [], 0.0
        for side in (points_m[~right], points_m[right]):
            try:
                if len(side) < self._settings.min_points:
                    return math.nan, math.nan
                of_side, _, _ = fit_plane(side, self._settings)
            except MeasurementError:
                return math.nan, math.nan
            facing = of_side.normal @ plane.normal
            offsets.append(-(of_side.normal @ at_crack + of_side.d) / facing)
            by_plane = np.append(at_crack, 1) / facing
            variance += by_plane @ of_side.covariance @ by_plane
        return offsets[1] - offsets[0], math.sqrt(variance)

    def select(self, points_m: Array, homography: Array) -> tuple[Array, Array]:
        """The points of a ToF cloud (N, 3) [m] whose projection (Eq. 4.1) falls into the panel region of the reference.

        Args:
            homography: reference -> image, in ideal pixels.

        Returns:
            They in the camera frame (N, 3) [m], and where they lie in the raw reference image (N, 2) [px].
        """
        points, reference_px, chosen = self._seen(points_m, homography)
        return points[chosen], reference_px[chosen]

    def _seen(self, points_m: Array, homography: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """As `select`, of all points, and which of them it selects (N,)."""
        camera, settings = self._calibration.camera, self._settings
        points = points_m @ self._calibration.R_camera_tof.T + self._calibration.t_camera_tof
        reference = camera.distort(apply_homography(np.linalg.inv(homography), camera.project(points)))
        with np.errstate(invalid="ignore"):
            column, row = np.round(np.nan_to_num(reference, nan=-1)).astype(int).T
        seen = (points[:, 2] >= settings.min_distance_m) & (points[:, 2] <= settings.max_distance_m)
        seen &= (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        seen[seen] = self._mask[row[seen], column[seen]]
        return points, reference, seen

    def _near_panel(self, depth_m: NDArray[np.float32], homography: Array) -> Array:
        """Points (N, 3) [m] of the part of a depth image that holds the panel, whose few pixels in a coarse grid tell
        where that is; of all of it if the panel is too small for that."""
        coarse = depth_m[::COARSE, ::COARSE]
        seen = np.isfinite(coarse)
        seen[seen] = self._seen(_cloud(coarse, self._rays[::COARSE, ::COARSE]), homography)[2]
        part = np.s_[:, :]
        if seen.any():
            part = tuple(_around(np.flatnonzero(seen.any(axis=axis)) * COARSE) for axis in (1, 0))
        every = max(1, math.isqrt(np.count_nonzero(seen) * COARSE**2 // self._settings.max_points))
        return _cloud(depth_m[part][::every, ::every], self._rays[part][::every, ::every])


def _around(at: NDArray[np.intp]) -> slice:
    """From the first to the last, and some more."""
    return slice(max(at[0] - MARGIN, 0), at[-1] + MARGIN)


class PlaneMotion:
    """How much less certain a plane is at the moment of the image than at that of its ToF frame.

    The plane stays what it was measured to be (no interpolation, thesis 4.3.1), but its covariance grows by the change
    that its recent rate makes over the time between the two.
    """

    def __init__(self) -> None:
        self._last: tuple[int, Array] | None = None
        self._rate = np.zeros(3)  # of the inverse depth [1/(m s)]

    def at_image(self, plane: Plane, depth_stamp_ns: int, stamp_ns: int) -> Plane:
        """The plane with its covariance at the image. Planes must come in the order of time."""
        pi = plane.inverse_depth
        if self._last is not None and depth_stamp_ns > self._last[0]:
            self._rate = (pi - self._last[1]) / ((depth_stamp_ns - self._last[0]) * 1e-9)
        self._last = (depth_stamp_ns, pi)
        change = self._rate * (stamp_ns - depth_stamp_ns) * 1e-9
        return Plane.from_inverse_depth(pi, plane.inverse_depth_covariance() + np.outer(change, change))
