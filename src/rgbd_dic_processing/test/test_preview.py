"""What the regions page tells before a flight: expected uncertainty, refusals, lengths, outlines carried along."""

from __future__ import annotations

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RegionsError
from rgbd_dic_processing.core.carried_regions import carried_entries, carried_regions
from rgbd_dic_processing.core.correlation import CorrelationSettings, ReferenceSubsets
from rgbd_dic_processing.core.geometry import Plane, apply_homography
from rgbd_dic_processing.core.panel_ruler import PanelRuler
from rgbd_dic_processing.core.preview import crossing_edges, preview
from rgbd_dic_processing.core.regions_file import entries_of_text, regions_of, text_of
from rgbd_dic_processing.core.settings import ProcessingSettings
from scipy.ndimage import gaussian_filter

WIDTH, HEIGHT, NOISE = 320, 240, 1.5
CAMERA = Camera(WIDTH, HEIGHT, 600.0, 600.0, 160.0, 120.0, 0.05, 0.02)
PANEL = [[10, 10], [310, 10], [310, 230], [10, 230]]
LEFT = [[10, 10], [150, 10], [150, 230], [10, 230]]
CRACK = {"left": [80, 60, 140, 180], "right": [180, 60, 240, 180], "direction": [0, 1]}
GOOD = {"panel": PANEL, "fixed": [LEFT], "crack": CRACK}


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    """Band-limited speckle (rows, cols) of 30 grey levels."""
    noise = gaussian_filter(np.random.default_rng(4).standard_normal((HEIGHT, WIDTH)), 2.0)
    return 128 + 30 * noise / noise.std()


def look(texture: np.ndarray, entries: dict):
    return preview(np.round(texture).astype(np.uint8), CAMERA, regions_of(entries), ProcessingSettings(), NOISE)


def test_expected_uncertainty_is_what_a_noisy_image_then_has(texture: np.ndarray) -> None:
    """Over 60 pairs of noisy images, the scatter of each subset about its place is the expected sigma: their ratio,
    pooled over 35 subsets that hardly overlap and two axes, is known to 1 / sqrt(2 * 60 * 70) = 1.1 %; and so is what
    the correlation states from its residual."""
    rng, settings = np.random.default_rng(5), CorrelationSettings()
    centres = np.stack(np.meshgrid(np.arange(40, 281, 40), np.arange(40, 201, 40)), -1).reshape(-1, 2).astype(float)
    seeds = np.zeros((len(centres), 2, 6))
    seeds[:, :, 0] = centres
    seeds[:, 0, 1] = seeds[:, 1, 2] = 1
    away, stated = [], []
    for _ in range(60):
        pair = texture + NOISE * rng.standard_normal((2, *texture.shape))
        reference = ReferenceSubsets(pair[0], centres, settings)
        found = reference.correlate(reference.target(pair[1]), seeds)
        away.append(np.column_stack([found.x_px, found.y_px]) - centres)
        stated.append(np.column_stack([found.sigma_x_px, found.sigma_y_px]))
    expected = reference.expected_sigma_px(NOISE)
    assert np.sqrt(np.mean((np.array(away) / expected) ** 2)) == pytest.approx(1, abs=0.035)  # three deviations
    assert np.mean(np.array(stated) / expected) == pytest.approx(1, abs=0.02)
    assert reference.expected_sigma_px(2 * NOISE).mean() == pytest.approx(2 * expected.mean(), rel=0.02)


def test_a_bare_patch_has_no_expected_uncertainty_and_is_refused(texture: np.ndarray) -> None:
    bare = texture.copy()
    bare[40:200, 160:260] = 128
    seen = look(bare, GOOD)
    assert np.isnan(seen.sigma_px[seen.right]).all() and np.isfinite(seen.sigma_px[seen.left]).all()
    assert any("right zone" in refusal and "texture" in refusal for refusal in seen.refusals)


def test_good_regions_are_neither_refused_nor_warned_of(texture: np.ndarray) -> None:
    seen = look(texture, GOOD)
    assert not seen.refusals and not seen.warnings
    assert seen.left.sum() == seen.right.sum() == 6 * 12 and not (seen.left & seen.right).any()
    assert 0 < seen.u_opening_px < seen.sigma_px.mean()  # the mean of 72 subsets each side is better than one subset


@pytest.mark.parametrize(
    "change, said",
    [
        ({"crack": {**CRACK, "left": [86, 66, 94, 74]}}, "left zone holds no subset centre"),
        ({"fixed": [PANEL]}, "fixed region lies across the crack line"),
        ({"fixed": [LEFT, [[200, 20], [300, 20], [300, 220], [200, 220]]]}, "fixed region lies across the crack line"),
        ({"crack": {**CRACK, "left": [100, 60, 190, 180]}}, "left zone reaches across the crack line"),
        ({"panel": [[10, 10], [310, 230], [310, 10], [10, 230]]}, "panel: its outline crosses itself"),
        ({"panel": [[10, 10], [400, 10], [310, 230], [10, 230]]}, "outside the image"),
        ({"fixed": [[[26, 26], [50, 26], [50, 50], [26, 50]]]}, "compensation.min_subsets"),
        ({"panel": [[10, 10], [30, 10], [30, 30], [10, 30]]}, "no whole subset"),
    ],
)
def test_what_cannot_work_is_refused_with_its_reason(texture: np.ndarray, change: dict, said: str) -> None:
    refusals = look(texture, {**GOOD, **change}).refusals
    assert any(said in refusal for refusal in refusals), refusals


def test_what_is_cut_out_of_the_fixed_region_mends_it(texture: np.ndarray) -> None:
    """All of the panel less its right side is the left side."""
    hole = [[150, 0], [319, 0], [319, 239], [150, 239]]
    seen = look(texture, {**GOOD, "fixed": [PANEL], "fixed_holes": [hole]})
    assert not seen.refusals
    assert np.array_equal(seen.fixed, seen.centres_px[:, 0] < 150)


@pytest.mark.parametrize(
    "change, said",
    [
        ({"fixed": []}, "h_joint alone"),
        ({"crack": None}, "no crack opening"),
        ({"crack": {**CRACK, "left": [80, 60, 155, 180]}}, "reach over the crack line"),
    ],
)
def test_what_makes_it_worse_is_warned_of(texture: np.ndarray, change: dict, said: str) -> None:
    seen = look(texture, {**GOOD, **change})
    assert not seen.refusals and any(said in warning for warning in seen.warnings), seen


def test_crossing_edges() -> None:
    assert crossing_edges(np.array(PANEL)) is None
    assert crossing_edges(np.array([[0, 0], [10, 10], [10, 0], [0, 10]])) == (0, 2)


def test_lengths_on_a_slanted_plane() -> None:
    """Points of the plane 1 m away, turned by 20 degrees, projected and measured back."""
    angle = np.radians(20)
    normal, across = np.array([np.sin(angle), 0, np.cos(angle)]), np.array([np.cos(angle), 0, -np.sin(angle)])
    plane = Plane(normal, -np.cos(angle), np.zeros((4, 4)))  # it meets the optical axis at 1 m
    start, end = np.array([0, 0, 1.0]) - 0.1 * across, np.array([0, 0, 1.0]) + 0.12 * across + [0, 0.05, 0]
    ruler = PanelRuler(CAMERA, plane)
    pixels = CAMERA.distort(CAMERA.project(np.stack([start, end])))
    assert ruler.length_m(*pixels) == pytest.approx(np.hypot(0.22, 0.05), abs=1e-12)
    sizes = ruler.sizes_m(regions_of(GOOD))
    assert sizes["distance"] == pytest.approx(1.0, abs=1e-9)
    assert sizes["left zone across"] > sizes["right zone across"]  # the left side is farther away
    assert sizes["left zone along"] == pytest.approx(0.2, rel=0.1) and sizes["pixel"] == pytest.approx(1 / 600, rel=0.1)


def test_outlines_follow_the_motion() -> None:
    homography = np.array([[0.98, -0.05, 12.0], [0.05, 0.98, -7.0], [1e-5, 2e-5, 1.0]])
    regions = regions_of({**GOOD, "fixed_holes": [[[20, 20], [40, 20], [40, 40]]]})
    carried = carried_regions(regions, CAMERA, homography)
    ideal = apply_homography(homography, CAMERA.undistort(regions.panel))
    np.testing.assert_allclose(carried["panel"][0], CAMERA.distort(ideal), atol=1e-9)
    assert [len(carried[name]) for name in ("fixed", "fixed_holes", "left", "right", "crack")] == [1] * 5
    assert carried_regions(regions, CAMERA, np.full((3, 3), np.nan))["panel"] == []


@pytest.mark.parametrize("crack", [CRACK, {"point": [150, 110], "direction": [0.1, 1], "size": [40, 60], "gap": 20}])
def test_entries_are_carried_into_another_image(crack: dict) -> None:
    """Corners as exactly as they are written; zones keep their middles, and nearly their width."""
    homography = np.array([[1.02, -0.03, 5.0], [0.03, 1.02, -4.0], [1e-5, 2e-5, 1.0]])
    entries = {**GOOD, "panel": [[20, 20], [290, 20], [290, 220], [20, 220]], "crack": crack}
    there = regions_of(carried_entries(entries, CAMERA, homography))
    exact = carried_regions(regions_of(entries), CAMERA, homography)
    np.testing.assert_allclose(there.panel, exact["panel"][0], atol=0.051)
    for side in ("left", "right"):
        zone = getattr(there.crack, side)
        np.testing.assert_allclose(zone.mean(axis=0), exact[side][0].mean(axis=0), atol=0.6)
        assert np.ptp(zone @ there.crack.normal) == pytest.approx(np.ptp(exact[side][0] @ there.crack.normal), rel=0.1)
    middle = exact["crack"][0]
    along = (middle[1] - middle[0]) / np.linalg.norm(middle[1] - middle[0])
    assert abs(along @ there.crack.direction) > 0.9999


def test_entries_survive_their_text() -> None:
    entries = {**GOOD, "x_axis": [[20, 100], [300, 100]], "fixed_holes": [[[20, 20], [40, 20], [40, 40]]]}
    entries["fixed"] = [LEFT, LEFT]  # the same twice is written out twice
    assert entries_of_text(text_of(entries)) == entries


@pytest.mark.parametrize(
    "text, said",
    [
        ("panel: &a [[0, 0]]\nfixed: [*a]", "aliases"),
        ("[" * 5000, "not a regions.yaml"),
        ("panel: [1", "not a regions.yaml"),
        ("speed: 3", "unknown entry speed"),
        ("{panel: [[0, 0], [9, 0], [9, 9]], fixed: 7}", "list of polygons"),
    ],
)
def test_hostile_texts_are_refused_in_words(text: str, said: str) -> None:
    with pytest.raises(RegionsError, match=said):
        entries_of_text(text)
