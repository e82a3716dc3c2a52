"""The adjustment of both sensors, from corners without images: derivatives, honest uncertainties, what is missing."""

from __future__ import annotations

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.calibrating.board import Board, BoardSettings
from rgbd_dic_processing.calibrating.bundle import adjust
from rgbd_dic_processing.calibrating.detection import Found
from rgbd_dic_processing.calibrating.model import Layout, Model, View
from rgbd_dic_processing.calibrating.settings import CalibratingSettings
from rgbd_dic_processing.calibrating.sufficiency import missing
from rgbd_dic_processing.calibrating.views import BoardView, Gathering
from scipy.spatial.transform import Rotation

BOARD = Board(BoardSettings())
CAMERA = Camera(1440, 1080, 2458.5, 2465.9, 719.5, 539.5, 0.0084, 0.0843)
TOF = Camera(640, 480, 521.3, 522.2, 319.5, 239.5)
R_CT, T_CT = Rotation.from_rotvec([0.031, 0.027, 0.004]), np.array([-0.02586, -0.0667, 0.06109])
MODELS = {"camera": Model(1440, 1080, False, True), "tof": Model(640, 480, False, False)}
CENTRES = [(400, 300), (1040, 300), (400, 780), (1040, 780), (720, 540)]
TILTS_DEG = [(20, 0), (0, 20), (-20, 0), (0, -20), (18, 18), (-18, 15), (15, -18), (-18, -18), (25, 5), (-5, 25)]


def pose(index: int, tilt_deg: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    centre = np.array([CENTRES[index % 5]], float)
    turn = Rotation.from_euler("yxz", [*tilt_deg, 4 * (index % 4)], degrees=True)
    return turn.as_matrix(), (1.5 + 0.1 * (index % 5)) * CAMERA.rays(centre)[0]


def found(camera: Camera, points: np.ndarray, noise_px: float, random: np.random.Generator) -> Found:
    exact = camera.distort(camera.project(points))
    return Found(exact + noise_px * random.standard_normal(exact.shape), np.arange(len(points)), 2.0, 20.0)


def view(index: int, tilt_deg: tuple[float, float], random: np.random.Generator, noisy: float = 1.0) -> BoardView:
    """A board in both sensors; the noise differs from board to board."""
    R, t = pose(index, tilt_deg)
    points = BOARD.corners_m @ R.T + t
    grain = noisy * (0.5 + index % 3)
    return BoardView(
        f"board{index}",
        found(CAMERA, points, 0.03 * grain, random),
        found(TOF, R_CT.inv().apply(points - T_CT), 0.06 * grain, random),
    )


def gathered(views: list[BoardView]) -> Gathering:
    gathering = Gathering([], BOARD)
    gathering.views = views
    gathering.sizes = {"camera": (1440, 1080), "tof": (640, 480)}
    gathering.seen.update(camera=len(views), tof=len(views))
    return gathering


def wants(tilts_deg: list[tuple[float, float]], places: list[int] | None = None) -> str:
    """What is missing, with boards of these tilts, at all places or at these."""
    random = np.random.default_rng(0)
    places = places or list(range(len(tilts_deg)))
    views = [view(place, tilt, random) for place, tilt in zip(places, tilts_deg, strict=True)]
    return "\n".join(missing(gathered(views), BOARD, MODELS, CalibratingSettings()))


def test_derivatives() -> None:
    """By central differences, which are good to 1e-6 of the largest."""
    models = {"camera": Model(1440, 1080, True, True), "tof": Model(640, 480, True, True)}
    layout = Layout(models, 2)
    x = np.array([2400, 2450, 700, 530, 0.01, 0.05, 520, 525, 318, 241, 0.02, -0.03], float)
    x = np.concatenate([x, [-0.03, -0.02, 0.01, 0.02, 0.07, -0.06], np.zeros(6), [0.2, -0.3, 0.1, 0.1, -0.05, 1.4]])
    for sensor in models:
        projection = layout.project(x, 1, sensor, BOARD.corners_m)
        full = np.zeros((2 * len(BOARD.corners_m), layout.size))
        full[:, projection.columns] = projection.jacobian
        for j in range(layout.size):
            step = np.zeros(layout.size)
            step[j] = 1e-6 * max(1.0, abs(x[j]))
            ends = [layout.project(x + s * step, 1, sensor, BOARD.corners_m).pixels.ravel() for s in (1, -1)]
            difference = (ends[0] - ends[1]) / (2 * step[j])
            np.testing.assert_allclose(full[:, j], difference, atol=1e-6 * max(1.0, np.abs(difference).max()))


def test_stated_uncertainties_are_honest() -> None:
    """Errors over their sigmas, 12 times with new noise that differs from board to board: about 70 independent numbers,
    whose RMS is known to 9 %; the jackknife may widen by some 10 %."""
    truth = np.array([2458.5, 2465.9, 0.0084, 0.0843, 521.3, 522.2, 0, 0, 0, *T_CT])
    pulls = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        estimate = adjust([view(i, tilt, random) for i, tilt in enumerate(TILTS_DEG)], BOARD, MODELS)
        turn = (Rotation.from_matrix(estimate.calibration.R_camera_tof) * R_CT.inv()).as_rotvec()
        values = np.array([*estimate.values[:6], *turn, *estimate.values[9:]])
        pulls.append((values - truth) / estimate.sigmas)
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.2
    assert np.abs(pulls).max() < 4


def test_noise_of_every_image_is_found() -> None:
    random = np.random.default_rng(1)
    estimate = adjust([view(i, tilt, random) for i, tilt in enumerate(TILTS_DEG)], BOARD, MODELS)
    for (index, sensor), fit in estimate.fits.items():
        true_px = (0.03 if sensor == "camera" else 0.06) * (0.5 + index % 3)
        assert fit.noise_px == pytest.approx(true_px, rel=0.25)  # 176 numbers: 5 % standard deviation


def test_boards_in_one_sensor_alone_help_too() -> None:
    random = np.random.default_rng(2)
    views = [view(i, tilt, random) for i, tilt in enumerate(TILTS_DEG)]
    alone = [views[0].without("tof"), views[1].without("camera"), *views[2:]]
    estimate = adjust([View(v.name, v.camera, v.tof) for v in alone], BOARD, MODELS)
    assert set(estimate.fits) == {(i, s) for i in range(10) for s in MODELS} - {(0, "tof"), (1, "camera")}
    assert abs(estimate.value("camera.fx") - 2458.5) < 3.5 * estimate.sigma("camera.fx")


def test_wrong_corners_are_left_out() -> None:
    random = np.random.default_rng(3)
    views = [view(i, tilt, random) for i, tilt in enumerate(TILTS_DEG)]
    views[4].camera.corners_px[[3, 40]] += [2.0, -3.0]
    estimate = adjust(views, BOARD, MODELS)
    assert np.flatnonzero(np.isnan(estimate.fits[4, "camera"].residuals_px[:, 0])).tolist() == [3, 40]


def test_good_boards_lack_nothing() -> None:
    assert wants(TILTS_DEG) == ""


@pytest.mark.parametrize(
    "tilts_deg, said",
    [
        ([(20, y) for y in (20, -20) * 5], "all boards are tilted the same way; tilt it about its vertical axis"),
        ([(x, y) for x, y in zip(range(5, 35, 3), (20, -20) * 5, strict=True)], "seen from one side only, its right"),
        ([(x, -20 + i) for i, x in enumerate((20, -20) * 5)], "tilt it about its horizontal axis the other way, upper"),
        ([(0, 0)] * 10, "tilt it about its vertical axis by 7 degrees or more, to both sides"),
    ],
)
def test_missing_tilts(tilts_deg: list[tuple[float, float]], said: str) -> None:
    assert said in wants(tilts_deg)


def test_missing_quarter() -> None:
    said = wants(TILTS_DEG, places=[1, 2, 3, 1, 2, 3, 1, 2, 3, 1])
    assert "of the upper left quarter of the image" in said or "no board in the upper left quarter" in said
    assert "lower right" not in said


def test_too_few_boards_and_pairs() -> None:
    random = np.random.default_rng(0)
    views = [view(i, tilt, random) for i, tilt in enumerate(TILTS_DEG)]
    few = [v.without("tof") if i > 3 else v for i, v in enumerate(views)]
    said = "\n".join(missing(gathered(few), BOARD, MODELS, CalibratingSettings()))
    assert "ToF sensor: 4 usable boards in 10 images, at least 8 different ones are needed" in said
    assert "4 boards are seen by both at once, at least 5" in said
    assert "camera: " not in said


def test_boards_that_are_alike_count_once() -> None:
    random = np.random.default_rng(0)
    gathering = gathered([view(i // 2, TILTS_DEG[i // 2], random, noisy=0.5) for i in range(20)])
    gathering._moved_px = {v.name: 0.0 for v in gathering.views}
    gathering.screen(CalibratingSettings())
    assert len(gathering.views) == 10
    assert all("where it was in" in skipped.reason for skipped in gathering.skipped)
