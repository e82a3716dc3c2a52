"""ToF planes carried in time: where the panel's plane is at an image, and what h_3d and pc_3d make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rgbd_dic_acquisition.simulator.laboratory_motion import HAND
from rgbd_dic_acquisition.simulator.motion import HandheldMotion
from rgbd_dic_processing.core.crack import CrackMeasurement, CrackOpening
from rgbd_dic_processing.core.displacement import DisplacementMeasurement
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.pairing import FramePairing
from rgbd_dic_processing.core.panel_motion import PanelMotion, carried_back, pose_sensitivity
from rgbd_dic_processing.core.plane_in_time import CarriedPlanes
from rgbd_dic_processing.core.sensor_delay import SensorDelay
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings, PairingSettings
from scenes import ExactScene, pose
from scipy.spatial.transform import Rotation
from test_uncertainty import CAMERA, SIGMA_PX, correlated_noise

PLANE = Plane.from_inverse_depth(np.array([0.05, -0.03, 0.9]), np.diag([1e-4, 2e-4, 5e-5]) ** 2)
MOVED = pose((3, -2, 4), (0.02, 0.03, -0.01))
TILT, DISTANCE_M = 2e-4, 1e-4  # noise of a ToF plane


def test_carried_back_is_what_planes_do() -> None:
    seen = PLANE.moved(*MOVED).inverse_depth
    np.testing.assert_allclose(carried_back(seen[None], MOVED[0][None], MOVED[1][None])[0], PLANE.inverse_depth)


def test_pose_sensitivity_is_the_derivative() -> None:
    """Against central differences of 1e-6, exact to their square."""
    expected = []
    for step in 1e-6 * np.eye(6):
        ends = []
        for sign in (1, -1):
            R = Rotation.from_rotvec(sign * step[:3]).as_matrix() @ MOVED[0]
            ends.append(PLANE.moved(R, MOVED[1] + sign * step[3:]).inverse_depth)
        expected.append((ends[0] - ends[1]) / 2e-6)
    np.testing.assert_allclose(pose_sensitivity(PLANE.inverse_depth, MOVED), np.transpose(expected), atol=1e-8)


def test_poses_between_images_and_none_in_gaps() -> None:
    """A turn of 3 Hz, sampled at 60 Hz: a cubic spline is within (pi / 10)^4 / 384 = 2.5e-5 of the amplitude inside."""
    motion = PanelMotion()
    stamps = [i * 16_666_667 for i in range(30) if not 12 <= i < 20]

    def turn(time_ns: float) -> np.ndarray:
        return np.array([0.01 * np.sin(2 * np.pi * 3 * time_ns * 1e-9), 0, 0.3])

    for stamp in stamps:
        motion.add(stamp, (Rotation.from_rotvec(turn(stamp)).as_matrix(), turn(stamp)))
    asked = np.array([90_000_000, 110_000_000, 250_000_000, -1, 500_000_000])
    R, t = motion.at(asked)
    for i in (0, 1):
        np.testing.assert_allclose(t[i], turn(asked[i]), atol=1e-6)
        np.testing.assert_allclose(R[i], Rotation.from_rotvec(turn(asked[i])).as_matrix(), atol=1e-6)
    assert np.isnan(t[2:]).all()


def test_mean_over_the_window_and_its_uncertainty() -> None:
    """A still camera: of eight planes with equal noise the last four lie in the window; the mean of four differs from
    that of eight by a variance of 1/4 - 1/8 of a plane's. A ToF frame after the image is not used yet."""
    motion, planes, still = PanelMotion(), CarriedPlanes(0.2), (np.eye(3), np.zeros(3))
    random = np.random.default_rng(1)
    truth, covariance = PLANE.inverse_depth, PLANE.inverse_depth_covariance()
    measured = 1e-3 * random.multivariate_normal(truth, covariance, 9) + (1 - 1e-3) * truth  # less than their noise
    for i, pi in enumerate(measured):
        motion.add(i * 50_000_000, still)
        planes.add(i * 50_000_000 + (i == 8), Plane.from_inverse_depth(pi, covariance))
        seen = planes.at_image(i * 50_000_000, motion, still, np.zeros((6, 6)))
        assert (seen is None) == (i == 0)  # between the first two images nothing is known yet
    np.testing.assert_allclose(seen.inverse_depth, measured[4:8].mean(axis=0))
    np.testing.assert_allclose(planes.reference.inverse_depth, measured[1:8].mean(axis=0))
    np.testing.assert_allclose(seen.inverse_depth_covariance(), covariance * (1 / 4 - 1 / 7), atol=1e-16)


def flown(
    seed: int, settings: list[CompensationSettings], duration_s: float, delay_s: float = 0.0, known_s: float = 0.0
) -> tuple[list[list[CrackOpening]], dict[int, float], SensorDelay]:
    """A hand-held flight before a half that is rigid: the openings by each of the settings, the truth by stamp [m], and
    the delay found. delay_s: of the ToF stamps; known_s: what `pairing.tof_delay_s` says of it."""
    random = np.random.default_rng(seed)
    flight = HandheldMotion(replace(HAND, distance_m=1.0), random)
    first = flight.pose(0.0)
    scene = ExactScene(CAMERA, first.R, first.t)
    steps = [DisplacementMeasurement(CAMERA, scene.regions, s) for s in settings]
    crack = CrackMeasurement(CAMERA, scene.regions.crack, CrackSettings())
    pairing = FramePairing(PairingSettings(tof_delay_s=known_s))
    covariance = np.diag([TILT, TILT, DISTANCE_M]) ** 2
    openings, truth = [[] for _ in settings], {}

    def give(kind: str, item: object) -> None:
        for found, step in zip(openings, steps, strict=True):
            found += [crack.measure(field) for field in getattr(step, kind)(item)]

    give("set_reference", scene.reference)
    images = [("image", 1 + round(i / 60 * 1e9)) for i in range(round(60 * duration_s))]
    depths = [("depth", 7_300_000 + round(i / 20 * 1e9)) for i in range(round(20 * duration_s))]
    for kind, exposed_ns in sorted(images + depths, key=lambda frame: frame[1] + 30_000_000 * (frame[0] == "depth")):
        view = flight.pose(exposed_ns * 1e-9)
        if kind == "image":
            truth[exposed_ns] = 3e-4 * (1 - np.cos(np.pi * exposed_ns * 1e-9))
            exact = scene.field(exposed_ns, view.R, view.t, np.array([truth[exposed_ns], 0, 0]))
            noise = correlated_noise(random, scene.reference.centres_px)
            sigma = np.full_like(exact.sigma_px, SIGMA_PX)
            give("add_field", replace(exact, moved_px=exact.moved_px + noise, sigma_px=sigma))
            pairs = pairing.add_image(exposed_ns)
        else:
            stamp = exposed_ns + round(delay_s * 1e9)
            exact = scene.estimate(stamp - round(known_s * 1e9), view.R, view.t)
            pi = random.multivariate_normal(exact.plane.inverse_depth, covariance)
            give("add_plane", replace(exact, plane=Plane.from_inverse_depth(pi, covariance)))
            pairs = pairing.add_depth(stamp)
        for pair in pairs:
            give("add_pair", pair)
    for pair in pairing.flush():
        give("add_pair", pair)
    return openings, truth, steps[0].sensor_delay()


def errors(openings: list[CrackOpening], truth: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Of the valid ones, and their stated uncertainties [m]."""
    valid = [opening for opening in openings if opening.valid]
    return np.array([o.opening_m - truth[o.stamp_ns] for o in valid]), np.array([o.u_opening_m for o in valid])


def test_carried_planes_take_the_noise_of_h_3d_down_to_that_of_h_pose() -> None:
    """Frame-to-frame noise and RMS error: several times those of h_pose with the nearest plane, at most 10 % more with
    carried ones. And what is stated is the error: 90 frames tell it to 8 %, so a quarter is three of that."""
    settings = [CompensationSettings(method="h_pose")]
    for method in ("h_3d", "pc_3d"):
        for way in ("nearest", "carried"):
            settings.append(CompensationSettings(method=method, plane_in_time=way))
    openings, truth, _ = flown(1, settings, 1.5)
    error, stated = zip(*(errors(found, truth) for found in openings), strict=True)
    noise = [np.std(np.diff(e)) / np.sqrt(2) for e in error]
    rms = [np.sqrt(np.mean(e**2)) for e in error]
    for nearest, carried in ((1, 2), (3, 4)):
        assert noise[nearest] > 3 * noise[0] and rms[nearest] > 3 * rms[0]
        assert noise[carried] < 1.1 * noise[0] and rms[carried] < 1.1 * rms[0]
        assert len(error[carried]) == len(truth)
        assert 0.6 < rms[carried] / np.sqrt(np.mean(stated[carried] ** 2)) < 1.25


def test_a_known_delay_is_taken_off_and_an_unknown_one_found() -> None:
    """40 ms: found to 5 ms; with `pairing.tof_delay_s` nothing of it is left, in the opening either."""
    settings = [CompensationSettings(method="h_3d", plane_in_time="carried")]
    wrong, truth, found = flown(2, settings, 1.5, delay_s=0.04)
    right, _, rest = flown(2, settings, 1.5, delay_s=0.04, known_s=0.04)
    assert abs(found.delay_s - 0.04) < min(3 * found.u_s, 0.005) and "pairing.tof_delay_s" in found.warning
    assert abs(rest.delay_s) < min(3 * rest.u_s, 0.005) and rest.warning == ""
    rms = [np.sqrt(np.mean(errors(openings[0], truth)[0] ** 2)) for openings in (wrong, right)]
    assert rms[0] > 1.5 * rms[1]
