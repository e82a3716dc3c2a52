"""The panel found without a hint: jumps, turns, hidden parts, dropped frames; and never where it is not.

The speckle is a spline, evaluated at the pixels through the inverse of the view, so that the truth is exact.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.simulator.motion import HandheldMotion, MotionSettings
from rgbd_dic_processing.core.coarse import CoarseSearch
from rgbd_dic_processing.core.correlation import CorrelationSettings
from rgbd_dic_processing.core.features import FeatureMatcher
from rgbd_dic_processing.core.geometry import apply_homography
from rgbd_dic_processing.core.prediction import Prediction
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.search import SeedSource
from rgbd_dic_processing.core.seed_maps import SeedMaps
from rgbd_dic_processing.core.settings import SearchSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_grid import SubsetGrid
from rgbd_dic_processing.core.tracking import SubsetField, SubsetTracking
from scipy import ndimage

CAMERA = Camera(800, 600, 1300.0, 1300.0, 399.5, 299.5, -0.1, 0.05)
PANEL = (110.0, 100.0, 530.0, 500.0)  # left, top, right, bottom in the reference [px]
SECOND = 1_000_000_000


@cache
def pattern(sigma_px: float, seed: int = 0) -> np.ndarray:
    """Spline coefficients of Gaussian speckle, larger than any view of it."""
    noise = np.random.default_rng(seed).standard_normal((1300, 1500)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma_px)
    return ndimage.spline_filter(128 + 38 * smooth / smooth.std(), order=3, output=np.float32)


@cache
def rays_px(camera: Camera) -> np.ndarray:
    """Ideal pixels (rows, cols, 2) of all raw pixels."""
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return camera.undistort(np.stack([x, y], axis=-1).reshape(-1, 2)).reshape(camera.height, camera.width, 2)


def view(H: np.ndarray, sigma_px: float = 1.5, seed: int = 0, camera: Camera = CAMERA) -> np.ndarray:
    """The panel before a shaded wall, under H (reference -> image, ideal pixels), with noise of one grey level."""
    at = rays_px(camera)
    source = at @ np.linalg.inv(H)[:, :2].T + np.linalg.inv(H)[:, 2]
    raw = camera.distort((source[..., :2] / source[..., 2:]).reshape(-1, 2))
    left, top, right, bottom = np.multiply(PANEL, camera.width / CAMERA.width)
    on_panel = ((raw > (left, top)) & (raw < (right, bottom))).all(axis=1)
    image = 90 + 0.1 * at[..., 0].ravel()
    inside = raw[on_panel][:, ::-1].T + 200
    image[on_panel] = ndimage.map_coordinates(pattern(sigma_px, seed), inside, order=3, prefilter=False)
    image += np.random.default_rng(np.frombuffer(H.tobytes(), np.uint32)).standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8).reshape(at.shape[:2])


def turned(degrees: float, shift: tuple[float, float], scale: float = 1.0) -> np.ndarray:
    """A homography about the panel's middle."""
    middle = np.array([(PANEL[0] + PANEL[2]) / 2, (PANEL[1] + PANEL[3]) / 2])
    c, s = scale * np.cos(np.radians(degrees)), scale * np.sin(np.radians(degrees))
    H = np.eye(3)
    H[:2, :2] = [[c, -s], [s, c]]
    H[:2, 2] = middle + shift - H[:2, :2] @ middle
    H[2, :2] = (2e-5, -1e-5)
    return H / H[2, 2]


def tracking(sigma_px: float = 1.5, camera: Camera = CAMERA) -> SubsetTracking:
    left, top, right, bottom = np.multiply(PANEL, camera.width / CAMERA.width)
    panel = np.array([(left + 2, top + 2), (right - 2, top + 2), (right - 2, bottom - 2), (left + 2, bottom - 2)])
    steps = SubsetTracking(camera, Regions(panel, (), None, None), CorrelationSettings(), SearchSettings())
    assert steps.track(0, view(np.eye(3), sigma_px, camera=camera)).status == FrameStatus.OK
    return steps


def where(steps: SubsetTracking, H: np.ndarray, camera: Camera = CAMERA) -> np.ndarray:
    """Where the subsets truly are (N, 2), raw pixels; NaN for those that leave the image."""
    centres = steps.reference.centres_px.astype(float)
    points = camera.distort(apply_homography(H, camera.undistort(centres)))
    points[((points < 30) | (points > (camera.width - 31, camera.height - 31))).any(axis=1)] = np.nan
    return points


def assert_found(field: SubsetField, truth: np.ndarray) -> None:
    """All subsets whose truth is given are found, and are wrong by no more than they say.

    Subsets share pixels with their neighbours: of the fewest that a test has, some 30 are independent, so that the RMS
    of error over sigma scatters by 9 %. Three times that is allowed.
    """
    inside = np.isfinite(truth[:, 0])
    assert field.status == FrameStatus.OK and inside.sum() > 100
    assert np.mean(field.subset_status[inside] == 0) > 0.995
    ratio = (field.moved_px - truth)[inside] / field.sigma_px[inside]
    assert np.sqrt(np.nanmean(ratio**2)) < 1.27


JUMPS = {
    "23 px": (turned(0, (23, -11)), SeedSource.COARSE),
    "300 px": (turned(0, (300, -20)), SeedSource.COARSE),
    "a step nearer": (turned(1, (40, 30), 1.02), SeedSource.COARSE),
    "30 degrees": (turned(30, (60, 10)), SeedSource.FEATURES),
    "half round, farther": (turned(-160, (40, -20), 0.75), SeedSource.FEATURES),
    "nearer": (turned(5, (60, 0), 1.35), SeedSource.FEATURES),
}


@pytest.mark.parametrize("sigma_px", [1.5, 3.0])
@pytest.mark.parametrize("jump", JUMPS)
def test_found_in_the_first_image_after_a_jump(jump: str, sigma_px: float) -> None:
    H, source = JUMPS[jump]
    steps = tracking(sigma_px)
    field = steps.track(SECOND, view(H, sigma_px))
    assert field.seed_source == source
    assert_found(field, where(steps, H))


@pytest.mark.parametrize("H", [turned(0.2, (1, 1)), turned(0, (60, -40)), turned(30, (60, 10))])
def test_found_with_half_of_it_behind_a_speckled_object(H: np.ndarray) -> None:
    steps = tracking()
    truth = where(steps, H)
    edge = int(np.nanmedian(truth[:, 0]))
    image = view(H)
    image[:, :edge] = np.clip(pattern(2.0, seed=5)[:600, :edge], 0, 255)
    truth[truth[:, 0] < edge + 25] = np.nan
    assert_found(steps.track(SECOND // 60, image), truth)


def test_followed_by_hand_with_dropped_frames_and_without_features(monkeypatch: pytest.MonkeyPatch) -> None:
    """40 % of 60 frames a second dropped, and seven in a row; each frame that arrives is found."""
    camera = CAMERA.scaled_to(400, 300)
    motion = HandheldMotion(MotionSettings(sway_m=0.02, sway_rad=0.02), np.random.default_rng(0))
    poses = [motion.pose(k / 60) for k in range(90)]
    kept = np.random.default_rng(2).random(90) > 0.4
    kept[0], kept[40:47] = True, False

    def no_features(*_: object) -> None:
        raise AssertionError("features were asked for")

    monkeypatch.setattr(FeatureMatcher, "match", no_features)
    steps, sources = tracking(camera=camera), []
    to_first = np.linalg.inv(camera.matrix @ np.column_stack([poses[0].R[:, :2], poses[0].t]))
    for k in np.flatnonzero(kept)[1:]:
        H = camera.matrix @ np.column_stack([poses[k].R[:, :2], poses[k].t]) @ to_first
        field = steps.track(k * SECOND // 60, view(H / H[2, 2], camera=camera))
        assert_found(field, where(steps, H / H[2, 2], camera))
        sources.append(field.seed_source)
    assert sources.count(SeedSource.PREDICTION) > 0.8 * len(sources)


SMALL = CAMERA.scaled_to(400, 300)


def chequered(period_px: float) -> np.ndarray:
    x, y = 2 * np.pi / period_px * np.array(np.meshgrid(np.arange(400), np.arange(300)))
    return np.rint(128 + 50 * np.sin(x) * np.sin(y)).astype(np.uint8)


@pytest.mark.parametrize("sigma_px", [1.5, 3.0])
@pytest.mark.parametrize(
    "other",
    [
        np.full((300, 400), 128, np.uint8),
        np.random.default_rng(0).integers(0, 255, (300, 400), np.uint8),
        view(np.eye(3), 1.5, seed=7, camera=SMALL),
        view(np.eye(3), 3.0, seed=7, camera=SMALL),
        view(np.eye(3), 1.5, camera=SMALL)[::-1].copy(),
        view(np.eye(3), 3.0, camera=SMALL)[::-1].copy(),
        chequered(7),
        chequered(16),
        chequered(60),
    ],
    ids=["uniform", "noise", "fine", "coarse", "fine mirrored", "coarse mirrored", "7 px", "16 px", "60 px"],
)
def test_nothing_is_found_where_the_panel_is_not(other: np.ndarray, sigma_px: float) -> None:
    """Nor a coarse speckle, of which a subset holds so little that chance may resemble it. Then it is found again."""
    steps = tracking(sigma_px, SMALL)
    field = steps.track(SECOND, other)
    assert field.status == FrameStatus.LOST and field.seed_source == SeedSource.NONE
    H = turned(0, (45, -8))
    assert_found(steps.track(2 * SECOND, view(H, sigma_px, camera=SMALL)), where(steps, H, SMALL))


# Parts


def test_prediction_is_exact_for_constant_acceleration_at_irregular_times() -> None:
    def at(stamp_ns: int) -> np.ndarray:
        t = stamp_ns / SECOND
        H = np.eye(3)
        H[0, 2], H[1, 0], H[2, 1] = 80 * t - 300 * t**2, 0.3 * t + t**2, 1e-4 * t
        return H

    prediction = Prediction()
    np.testing.assert_array_equal(prediction.at(5), np.eye(3))
    for stamp in (0, 17_000_000, 67_000_000, 84_000_000):
        prediction.add(stamp, at(stamp))
    np.testing.assert_allclose(prediction.at(150_000_000), at(150_000_000), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(prediction.at(10 * SECOND), at(84_000_000))  # not over seconds


@pytest.mark.parametrize("H", [turned(0, (250, -30)), turned(1.5, (-60, 80), 1.01)])
def test_coarse_search_is_good_to_a_pixel_or_two(H: np.ndarray) -> None:
    """A cell is 4 px here (800 / 200), the peak's parabola is good to a third of it."""
    x, y = np.meshgrid(np.arange(140.0, 510, 40), np.arange(130.0, 480, 40))
    points = np.column_stack([x.ravel(), y.ravel()])
    source, moved = CoarseSearch(view(np.eye(3)), points, 31).jumped(view(H), np.eye(3), points)
    truth = CAMERA.distort(apply_homography(H, CAMERA.undistort(source)))
    assert len(source) > len(points) / 3
    assert np.quantile(np.abs(moved - truth).max(axis=1), 0.9) < 2.0


def test_neighbours_against_a_search_of_all() -> None:
    """Of points as a renewed reference has them: carried along, some missing, some outside the image."""
    random = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(20, 400, 10), np.arange(30, 300, 10))
    centres = np.column_stack([x.ravel(), y.ravel()]) + random.uniform(-2, 2, (x.size, 2))
    centres = random.permutation(centres[random.random(len(centres)) > 0.2])
    centres[:20] = np.nan
    grid = SubsetGrid(centres, 10)
    values = random.normal(size=centres.shape)
    values[random.random(len(centres)) < 0.5] = np.nan
    values[:20] = np.nan
    members = np.isfinite(values[:, 0])
    distance = np.linalg.norm(centres[:, None] - centres, axis=-1)
    for index, median in enumerate(grid.median_around(values, np.arange(len(centres)))):
        near = members & (distance[index] < 15) & (distance[index] > 0)
        np.testing.assert_array_equal(median, np.median(values[near], axis=0) if near.any() else (np.nan, np.nan))
    nearest, best = grid.nearest(members), distance[:, members].min(axis=1)
    assert members[nearest].all()
    assert (distance[np.arange(len(centres)), nearest] < best + 15)[20:].all()
    np.testing.assert_array_equal(nearest[members], np.flatnonzero(members))
    points = random.uniform(0, 420, (500, 2))
    best = np.linalg.norm(points[:, None] - centres[members], axis=-1).min(axis=1)
    assert (np.linalg.norm(points - centres[grid.nearest(members, points)], axis=1) < best + 15).all()


def test_seeds_of_chosen_subsets_are_those_of_all() -> None:
    centres, chosen = np.random.default_rng(0).integers(50, 500, (40, 2)), np.array([7, 3, 30])
    maps = SeedMaps(CAMERA, centres, 15.5)
    H = turned(10, (30, 20))
    np.testing.assert_array_equal(maps.seeds(H, chosen), maps.seeds(H)[chosen])
