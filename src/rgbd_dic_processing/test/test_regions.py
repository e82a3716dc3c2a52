"""regions.yaml and what follows from it: zones, subsets, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rgbd_dic_acquisition.errors import RegionsError
from rgbd_dic_processing.core.regions import CrackZones, Regions, inside, polygon_mask
from rgbd_dic_processing.core.regions_file import load_regions

PANEL = np.array([(10.0, 10), (190, 10), (190, 140), (10, 140)])


@pytest.mark.parametrize("angle", [0, 30, 90, 150, -80])
@pytest.mark.parametrize("sign", [1, -1])
def test_zones_from_a_point_are_symmetric(angle: float, sign: int) -> None:
    along = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    point = np.array([100.0, 80])
    zones = CrackZones.from_point(point, sign * 3 * along, across=30, along=50, gap=8)
    np.testing.assert_allclose(
        zones.left + zones.right[[0, 1, 2, 3]], 2 * point + (zones.left + zones.right - 2 * point)
    )
    normal = np.array([zones.direction[1], -zones.direction[0]])
    for zone, side in ((zones.left, -1), (zones.right, 1)):
        away, beside = (zone - point) @ normal * side, (zone - point) @ zones.direction
        assert away.min() == pytest.approx(8) and away.max() == pytest.approx(38)
        assert beside.min() == pytest.approx(-25) and beside.max() == pytest.approx(25)
    assert abs(zones.direction @ along) == pytest.approx(1)
    assert normal[np.argmax(np.abs(normal))] > 0  # right is right, or below for a crack that is rather level


def test_rectangles_keep_their_names() -> None:
    """The user's left stays left, and the crack lies across the line between them."""
    a, b = np.array([20.0, 20, 60, 80]), np.array([100.0, 20, 140, 80])
    zones = CrackZones.from_rectangles(a, b)
    np.testing.assert_allclose(zones.direction, [0, 1], atol=1e-12)
    swapped = CrackZones.from_rectangles(b, a)
    np.testing.assert_allclose(swapped.direction, [0, -1], atol=1e-12)
    np.testing.assert_allclose(swapped.left.mean(axis=0), [120, 50])
    given = CrackZones.from_rectangles(a, b, np.array([-0.2, -1.0]))
    assert given.direction[1] > 0 and given.direction[0] == pytest.approx(0.2 / np.hypot(0.2, 1))


def test_subset_centres_lie_wholly_inside() -> None:
    triangle = Regions(np.array([(0.0, 0), (199, 0), (0, 149)]), (), None, None)
    centres = triangle.subset_centres(200, 150, 21, 5)
    for dx, dy in ((-10, -10), (10, -10), (10, 10), (-10, 10)):
        assert inside(triangle.panel, centres + np.array([dx, dy])).all()
    assert len(np.unique(centres, axis=0)) == len(centres) > 50
    assert centres.min() >= 10


def test_mask_is_the_polygon() -> None:
    mask = polygon_mask(PANEL, 200, 150)
    y, x = np.mgrid[0:150, 0:200]
    np.testing.assert_array_equal(mask.ravel(), inside(PANEL, np.column_stack([x.ravel(), y.ravel()])))


def test_fixed_region_is_the_panel_by_default() -> None:
    points = np.array([(50, 50), (5, 5), (150, 100)])
    assert Regions(PANEL, (), None, None).fixed_members(points).tolist() == [True, False, True]
    left = np.array([(10.0, 10), (60, 10), (60, 140), (10, 140)])
    assert Regions(PANEL, (left,), None, None).fixed_members(points).tolist() == [True, False, False]


@pytest.mark.parametrize(
    "text, said",
    [
        ("[1, 2]", "needs an entry 'panel'"),
        ("panel: [[0, 0], [1, 0], [.nan, 1]]", "expected at least 3 points"),
        ("panel: {a: 1}", "expected a list of points"),
        ("{panel: [[0, 0], [9, 0], [9, 9]], crack: [1]}", "expected left and right, or point"),
        (
            "{panel: [[0, 0], [9, 0], [9, 9]], crack: {point: [1, 2], direction: [0, 0], size: [1, 1]}}",
            "direction must not be",
        ),
        (
            "{panel: [[0, 0], [9, 0], [9, 9]], crack: {point: [1, 2], direction: [0, 1], size: [-1, 1]}}",
            "must be above 0",
        ),
        ("{panel: [[0, 0], [9, 0], [9, 9]], fixed: [[0, 0]]}", "fixed[0]"),
        ("panel: [", "cannot read regions"),
    ],
)
def test_malformed_files_name_the_entry(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "regions.yaml"
    path.write_text(text)
    with pytest.raises(RegionsError) as error:
        load_regions(path)
    assert said in str(error.value) and str(path) in str(error.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RegionsError, match="cannot read regions"):
        load_regions(tmp_path / "none.yaml")
