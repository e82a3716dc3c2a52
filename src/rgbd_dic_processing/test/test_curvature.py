"""A bowed panel: how the ToF sensor finds the bow, and what knowing it does to the opening."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_processing.core.crack import CrackMeasurement
from rgbd_dic_processing.core.curvature import Curvature, fit_curvature, tangents
from rgbd_dic_processing.core.displacement import DisplacementMeasurement
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.plane import PanelPlane, PlaneEstimate
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings, PlaneSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.surface_estimate import SurfaceEstimate
from rgbd_dic_processing.nodes.messages import plane_from_message, plane_message
from scenes import ExactScene, pair, pose

CAMERA = Camera(640, 480, 820.0, 835.0, 322.0, 236.5, -0.12, 0.05)
REFERENCE = pose((8, -12, 25), (0.02, -0.01, 1.1))
MOVED = pose((6, 9, -14), (0.05, -0.03, 1.07))
JUMP_M = np.array([0.8e-3, 0.3e-3, 0.0])
CURVATURE = 2 * 0.003 / 0.35**2  # 3 mm over half the width of what the camera sees of the panel
BOW = (CURVATURE, 0.2 * CURVATURE, 0.5 * CURVATURE)
KNOWN = {"bow_from": "images_and_tof", "bow_m": 0.01}


@dataclass(frozen=True)
class BowedScene(ExactScene):
    """The panel is z = k_xx x^2 / 2 + k_xy x y + k_yy y^2 / 2."""

    bow: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def height(self, points: np.ndarray) -> np.ndarray:
        x, y = points[:, 0], points[:, 1]
        return np.column_stack([x**2 / 2, x * y, y**2 / 2]) @ self.bow

    def material(self) -> np.ndarray:
        """On the rays of the reference; the height changes slowly, so the fixed point is reached in a few steps."""
        on_plane = super().material()
        centre = -self.R.T @ self.t
        points = on_plane
        for _ in range(30):
            points = centre + (on_plane - centre) * (1 - self.height(points) / centre[2])[:, None]
        return points

    def estimate(self, stamp: int, R: np.ndarray, t: np.ndarray) -> PlaneEstimate:
        """The mean plane of the surface, and its curvature, which is known."""
        points = self.material()
        terms = np.column_stack([points[:, :2], np.ones(len(points))])
        slope_x, slope_y, offset = np.linalg.lstsq(terms, points[:, 2], rcond=None)[0]
        normal = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
        small = 1e-12 * np.eye(4)
        plane = Plane(normal, -offset * normal[2], small).moved(R, t)
        G = tangents(plane.normal).T @ R[:, :2]
        K = G @ np.array([[self.bow[0], self.bow[1]], [self.bow[1], self.bow[2]]]) @ G.T
        curvature = Curvature(np.array([K[0, 0], K[0, 1], K[1, 1]]), 1e-10 * np.eye(3), np.zeros((3, 3)))
        return PlaneEstimate(stamp, FrameStatus.OK, "", plane, 1000, 1000, 0.001, curvature=curvature)


def opening_error_m(scene: ExactScene, **settings: object) -> float:
    """Length of the error of opening and sliding in a frame seen from elsewhere."""
    R, t = MOVED[0] @ REFERENCE[0], MOVED[0] @ REFERENCE[1] + [0.03, 0.02, -0.05]
    step = DisplacementMeasurement(CAMERA, scene.regions, CompensationSettings(**settings))
    crack = CrackMeasurement(CAMERA, scene.regions.crack, CrackSettings())
    step.set_reference(scene.reference)
    for stamp, (rotation, translation), shift in ((1, REFERENCE, 0 * JUMP_M), (2, (R, t), JUMP_M)):
        step.add_pair(pair(stamp))
        step.add_plane(scene.estimate(stamp, rotation, translation))
        (measured,) = step.add_field(scene.field(stamp, rotation, translation, shift))
    opening = crack.measure(measured)
    assert opening.valid, opening.reason
    return float(np.hypot(opening.opening_m - JUMP_M[0], opening.sliding_m - JUMP_M[1]))


def test_without_a_bow_nothing_moves() -> None:
    scene = ExactScene(CAMERA, *REFERENCE)
    flat = Curvature(np.zeros(3), 1e-10 * np.eye(3), np.zeros((3, 3)))
    ideal_px = CAMERA.undistort(scene.reference.centres_px)
    surface = SurfaceEstimate(CAMERA, ideal_px, 0.005, 3.0).surface(scene.plane(*REFERENCE), flat)
    np.testing.assert_allclose(surface.parallax_px(MOVED), 0, atol=1e-9)


def test_surface_of_a_known_bow() -> None:
    """The panel is quadratic in x and y, the surface in the rays, which perspective makes differ where the view is
    slanted: by 0.3 mm in the corner of the image, where the panel is 7 mm off its plane."""
    scene = BowedScene(CAMERA, *REFERENCE, bow=BOW)
    estimate = scene.estimate(1, *REFERENCE)
    ideal_px = CAMERA.undistort(scene.reference.centres_px)
    surface = SurfaceEstimate(CAMERA, ideal_px, 1.0, 3.0).surface(estimate.plane, estimate.curvature)
    true = scene.material() @ scene.R.T + scene.t
    flat = estimate.plane.points(surface.rays)
    assert np.abs(flat - true).max() > 3e-3
    np.testing.assert_allclose(surface.points(), true, atol=4e-4)


@pytest.mark.parametrize("method", ["h_pose", "h_joint"])
def test_a_known_bow_of_3_mm_does_little_harm(method: str) -> None:
    """Seen from 15 degrees and 10 cm elsewhere it costs h_pose 0.059 mm and h_joint 0.011 mm; 0.002 mm may be left."""
    bowed = BowedScene(CAMERA, *REFERENCE, bow=BOW)
    flat = opening_error_m(ExactScene(CAMERA, *REFERENCE), method=method, **KNOWN)
    ignored, known = (opening_error_m(bowed, method=method, **settings) for settings in ({"bow_m": 0.0}, KNOWN))
    assert flat < 1e-9
    assert known < 0.3 * ignored and known < 4e-6


def test_the_curvature_counts_only_where_it_is_asked_for() -> None:
    bowed = BowedScene(CAMERA, *REFERENCE, bow=BOW)
    assert opening_error_m(bowed, method="h_3d", **KNOWN) == opening_error_m(bowed, method="h_3d")


# The ToF sensor

CLEAN = {"wiggle_m": 0.0, "dark_offset_m": 0.0, "fixed_pattern_m": 0.0}
POSES = ({"distance_m": 2.2}, {"distance_m": 2.4, "yaw_rad": 0.3, "pitch_rad": 0.2})


def curvature_errors(tof: dict, bow_m: float) -> list[tuple[np.ndarray, Curvature]]:
    """Error of the curvature (3,), and what is stated, for the frame of each of a few sensors and poses."""
    found = []
    for seed, motion in [(seed, motion) for seed in range(1, 5) for motion in POSES]:
        static = {"bow_m": bow_m, "bulge": 0.0, "step": 0.0}
        groups = {"tof": {"scale": 0.5, **tof}, "motion": motion, "deformation": static, "camera": {"scale": 0.25}}
        lab = Laboratory(laboratory_settings("laboratory", {"seed": seed, **groups}))
        half = np.array([lab.settings.panel.width_m, lab.settings.panel.height_m]) / 2
        x, y = half - 0.03
        outline = lab.project(np.array([-x, x, x, -x]), np.array([-y, -y, y, y]), 0.4)
        step = PanelPlane(lab.calibration, Regions(outline, (), None, None), PlaneSettings())
        step.add_view(1, np.eye(3))
        (estimate,) = step.add_depth(1, lab.depth(0.4, 3).depth_m.astype(np.float32))
        true = Curvature(
            2 * bow_m * np.array([1, 0, 0.25]) / np.array([half[0] ** 2, 1, half[1] ** 2]), *[np.eye(3)] * 2
        )
        R = lab.pose(0.4).R
        found.append((estimate.curvature.values - true.turned(np.array([0.0, 0.0, 1.0]), R).values, estimate.curvature))
    return found


def chi2(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error)) / 3


@pytest.mark.parametrize("bow_m", [0.0, 0.003])
def test_curvature_from_noise_alone(bow_m: float) -> None:
    """Noise of 5 mm: a bow of 3 mm in 0.6 m is found to 0.3 mm in one frame. The mean of chi^2 / 3 of eight honest
    frames has a standard deviation of 0.29."""
    found = curvature_errors(CLEAN, bow_m)
    assert np.mean([chi2(error, stated.covariance) for error, stated in found]) < 1.9
    assert all(np.sqrt(stated.covariance[0, 0]) * 0.6**2 / 2 < 0.5e-3 for _, stated in found)


def test_curvature_with_all_errors_of_the_sensor() -> None:
    """What the sensor gets wrong in all frames alike fakes a bow of some 2 mm: the systematic part says so."""
    found = curvature_errors({}, 0.0008)
    assert 0.2 < np.mean([chi2(error, stated.covariance + stated.systematic) for error, stated in found]) < 1.9
    assert np.mean([chi2(error, stated.covariance) for error, stated in found]) > 3


def test_points_on_a_line_tell_no_curvature() -> None:
    points = np.column_stack([np.linspace(-0.5, 0.5, 200), np.zeros(200), np.full(200, 2.0)])
    assert (
        fit_curvature(points, Plane(np.array([0, 0, 1.0]), -2.0, np.zeros((4, 4))), np.zeros(3), PlaneSettings())
        is None
    )


def test_message_carries_the_curvature() -> None:
    estimate = BowedScene(CAMERA, *REFERENCE, bow=(0.05, 0.01, 0.02)).estimate(7, *MOVED)

    def make(typename: str, **fields: object) -> SimpleNamespace:
        return SimpleNamespace(**fields)

    back = plane_from_message(plane_message(make, estimate, "camera_optical_frame")).curvature
    for name in ("values", "covariance", "systematic"):
        np.testing.assert_array_equal(getattr(back, name), getattr(estimate.curvature, name))
    unknown = PlaneEstimate(7, FrameStatus.OK, "", estimate.plane)
    assert plane_from_message(plane_message(make, unknown, "camera_optical_frame")).curvature is None
