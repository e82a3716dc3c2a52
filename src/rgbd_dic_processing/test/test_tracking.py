"""Following subsets through rendered images: large motion, gaps, hidden parts, a wide crack."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RegionsError
from rgbd_dic_processing.core.correlation import CorrelationSettings
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.search import SeedSource
from rgbd_dic_processing.core.settings import SearchSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import SubsetField
from rgbd_dic_processing.core.tracking import SubsetTracking
from scipy.ndimage import map_coordinates, spline_filter

CAMERA = Camera(640, 480, 820.0, 820.0, 319.5, 239.5)
REGIONS = Regions(np.array([(150.0, 110), (490, 110), (490, 370), (150, 370)]), (), None, None)
SECOND = 1_000_000_000


@cache
def pattern() -> np.ndarray:
    """Spline coefficients of band-limited speckle, four times as large as the view."""
    noise = np.random.default_rng(0).standard_normal((1100, 1400)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.7)
    return spline_filter(np.clip(128 + 45 * smooth / smooth.std(), 0, 255), order=3)


def view(H: np.ndarray, jump_px: float = 0.0) -> np.ndarray:
    """The pattern seen under H (reference -> image); right of column 320 of the reference it is shifted by jump_px."""
    x, y = np.meshgrid(np.arange(640.0), np.arange(480.0))
    source = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(H).T
    u, v = source[..., 0] / source[..., 2], source[..., 1] / source[..., 2]
    u = np.where(u > 320 + jump_px, u - jump_px, u)
    image = map_coordinates(pattern(), [v + 310, u + 380], order=3, prefilter=False, mode="nearest")
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def turned(degrees: float, shift: tuple[float, float], tilt: float = 0.0) -> np.ndarray:
    """A homography about the image's middle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    to_middle = np.array([[1, 0, -320], [0, 1, -240], [0, 0, 1.0]])
    H = np.array([[c, -s, shift[0]], [s, c, shift[1]], [tilt, 0, 1]])
    H = np.linalg.inv(to_middle) @ H @ to_middle
    return H / H[2, 2]


def tracking() -> SubsetTracking:
    steps = SubsetTracking(CAMERA, REGIONS, CorrelationSettings(), SearchSettings())
    field = steps.track(0, view(np.eye(3)))
    assert field.seed_source == SeedSource.REFERENCE
    assert np.abs(field.moved_px - steps.reference.centres_px).max() < 1e-6
    return steps


def found(field: SubsetField) -> float:
    return float(np.mean(field.subset_status == 0))


def error_px(field: SubsetField, steps: SubsetTracking, H: np.ndarray) -> float:
    """RMS distance of the found subsets from the truth [px]."""
    points = np.column_stack([steps.reference.centres_px, np.ones(len(steps.reference.centres_px))]) @ H.T
    return float(np.sqrt(np.nanmean(np.sum((field.moved_px - points[:, :2] / points[:, 2:]) ** 2, axis=1))))


def test_smooth_motion_is_predicted() -> None:
    steps = tracking()
    for k in range(1, 8):
        H = turned(0.4 * k, (2.5 * k, -1.5 * k), 2e-5 * k)
        field = steps.track(k * SECOND // 60, view(H))
        assert field.seed_source == SeedSource.PREDICTION
        assert found(field) == 1 and error_px(field, steps, H) < 0.01


@pytest.mark.parametrize(
    "degrees, shift, source",
    [
        (0, (120, -70), SeedSource.COARSE),
        (30, (10, 5), SeedSource.FEATURES),
        (-25, (-60, 40), SeedSource.FEATURES),
    ],
)
def test_sudden_motion_is_recovered(degrees: float, shift: tuple[float, float], source: SeedSource) -> None:
    steps = tracking()
    H = turned(degrees, shift, 1e-4)
    field = steps.track(SECOND, view(H))
    assert field.status == FrameStatus.OK and field.seed_source == source
    assert found(field) > 0.99 and error_px(field, steps, H) < 0.01


def test_lost_and_found_again_at_once() -> None:
    steps = tracking()
    lost = steps.track(SECOND, np.zeros((480, 640), np.uint8))
    assert lost.status == FrameStatus.LOST and lost.view is None
    assert np.isnan(lost.moved_px).all() and lost.seed_source == SeedSource.NONE
    H = turned(12, (40, 20))
    again = steps.track(2 * SECOND, view(H))
    assert again.status == FrameStatus.OK and found(again) > 0.99 and error_px(again, steps, H) < 0.01


def test_unrelated_pattern_is_not_found() -> None:
    """The mirror image, a speckle of the same kind, must not be taken for the panel."""
    other = view(np.eye(3))[:, ::-1].copy()
    field = tracking().track(SECOND, other)
    assert field.status == FrameStatus.LOST


def test_hidden_half_leaves_the_other_half() -> None:
    steps = tracking()
    H = turned(1, (3, 2))
    image = view(H)
    image[:, :310] = 60
    field = steps.track(SECOND // 60, image)
    visible = steps.reference.centres_px[:, 0] > 340
    hidden = steps.reference.centres_px[:, 0] < 280
    assert (field.subset_status[visible] == 0).all() and error_px(field, steps, H) < 0.01
    assert (field.subset_status[hidden] != 0).all() and np.isnan(field.moved_px[hidden]).all()


@pytest.mark.parametrize("jump_px", [6.0, 24.0])
def test_both_sides_of_a_suddenly_wide_crack(jump_px: float) -> None:
    """No single homography fits both sides; the far side is found from the coarse image or from its own neighbours."""
    steps = tracking()
    field = steps.track(SECOND, view(np.eye(3), jump_px))
    moved = field.moved_px - steps.reference.centres_px
    x = steps.reference.centres_px[:, 0]
    left, right = x < 300, x > 340
    assert np.abs(moved[left]).max() < 0.05
    assert np.abs(moved[right] - (jump_px, 0)).max() < 0.05


def test_a_crack_that_widens_slowly_is_followed_by_prediction() -> None:
    """0.5 px a frame up to 20 px: far beyond what one subset's own search reaches from the common homography."""
    steps = tracking()
    for k in range(1, 41):
        field = steps.track(k * SECOND // 60, view(turned(0.1 * k, (k, 0)), 0.5 * k))
        assert field.seed_source == SeedSource.PREDICTION
    right = steps.reference.centres_px[:, 0] > 345
    assert (field.subset_status[right] == 0).mean() > 0.99


@pytest.mark.parametrize("first", [np.zeros((480, 640), np.uint8), np.full((480, 640), 255, np.uint8)])
def test_an_image_without_texture_is_no_reference(first: np.ndarray) -> None:
    """A black or a blinded first image: it says so, and the next good image becomes the reference."""
    steps = SubsetTracking(CAMERA, REGIONS, CorrelationSettings(), SearchSettings())
    refused = steps.track(0, first)
    assert refused.status == FrameStatus.BAD_IMAGE and "have texture" in refused.reason
    field = steps.track(SECOND, view(np.eye(3)))
    assert field.status == FrameStatus.OK and field.reference_stamp_ns == SECOND


def test_half_a_panel_without_speckle_is_followed_on_the_other_half() -> None:
    def half_blank(H: np.ndarray) -> np.ndarray:
        image = view(H)
        image[:, 300:] = 120
        return image

    steps = SubsetTracking(CAMERA, REGIONS, CorrelationSettings(), SearchSettings())
    steps.track(0, half_blank(np.eye(3)))
    H = turned(0.5, (-3, 2))
    field = steps.track(SECOND // 60, half_blank(H))
    left = steps.reference.centres_px[:, 0] < 270
    assert field.status == FrameStatus.OK and (field.subset_status[left] == 0).all()
    # the border of the blank half stands still in the image, so only subsets well away from it are compared
    expected = np.column_stack([steps.reference.centres_px, np.ones(len(left))]) @ H.T
    assert np.abs(field.moved_px - expected[:, :2])[left].max() < 0.02


@pytest.mark.parametrize("stamp", [SECOND, SECOND // 2])
def test_stamps_must_increase(stamp: int) -> None:
    steps = tracking()
    steps.track(SECOND, view(np.eye(3)))
    field = steps.track(stamp, view(np.eye(3)))
    assert field.status == FrameStatus.BAD_IMAGE and "not later" in field.reason


def test_a_clock_that_jumps_back_costs_one_image() -> None:
    """Even to the very stamp of the reference, whose own image it is not; the motion before it predicts nothing."""
    steps = SubsetTracking(CAMERA, REGIONS, CorrelationSettings(), SearchSettings())
    for stamp in range(1, 5):
        assert steps.track(stamp * SECOND, view(np.eye(3))).status == FrameStatus.OK
    assert steps.track(SECOND // 2, view(np.eye(3))).status == FrameStatus.BAD_IMAGE
    again = steps.track(steps.reference.stamp_ns, view(turned(0, (5, 0))))
    assert again.status == FrameStatus.OK and again.seed_source == SeedSource.PREDICTION
    moved = again.moved_px - steps.reference.centres_px
    np.testing.assert_allclose(np.nanmean(moved, axis=0), [5, 0], atol=0.01)


def test_bad_images_say_why_and_change_nothing() -> None:
    steps = tracking()
    before = steps.reference
    unreadable = steps.track(SECOND, None, "image encoding 'rgb8' is not supported")
    small = steps.track(2 * SECOND, np.zeros((100, 640), np.uint8))
    assert {unreadable.status, small.status} == {FrameStatus.BAD_IMAGE}
    assert "rgb8" in unreadable.reason and "640 x 100 px" in small.reason
    assert steps.reference is before


def test_bad_image_before_any_reference() -> None:
    steps = SubsetTracking(CAMERA, REGIONS, CorrelationSettings(), SearchSettings())
    field = steps.track(SECOND, None, "empty")
    assert field.status == FrameStatus.BAD_IMAGE and len(field.moved_px) == 0


def test_regions_that_do_not_fit_are_refused_at_the_first_image() -> None:
    outside = Regions(REGIONS.panel * 2, (), None, None)
    steps = SubsetTracking(CAMERA, outside, CorrelationSettings(), SearchSettings())
    with pytest.raises(RegionsError, match="outside the image of 640 x 480 px"):
        steps.track(0, view(np.eye(3)))


def test_a_region_beyond_the_lens_model_is_no_reference() -> None:
    """Where the distortion folds back no pixel has a ray: a zone there has no subsets left, and that is said."""
    folding = Camera(640, 480, 300.0, 300.0, 319.5, 239.5, -0.45)
    corner = np.array([(560.0, 400), (630, 400), (630, 470), (560, 470)])
    panel = np.array([(150.0, 110), (630, 110), (630, 470), (150, 470)])
    steps = SubsetTracking(folding, Regions(panel, (corner,), None, None), CorrelationSettings(), SearchSettings())
    field = steps.track(0, view(np.eye(3)))
    assert field.status == FrameStatus.BAD_IMAGE and "0% of the fixed region's subsets" in field.reason
