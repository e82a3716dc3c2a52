"""Chapter 3 of the thesis: the quick run is held to the numbers of the full one, and its parts to analytic truth."""

import re
from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.simulator.motion import thesis_pose
from rgbd_dic_processing.validation.chapter3.calibrating import BOARD, board_poses
from rgbd_dic_processing.validation.chapter3.chapter import FULL, QUICK, run_chapter3
from rgbd_dic_processing.validation.chapter3.measuring import (
    exact_plane,
    panel_per_pixel,
    panel_regions,
    pixels_per_m,
    project,
    true_px,
)
from rgbd_dic_processing.validation.chapter3.presentation import write_chapter3
from rgbd_dic_processing.validation.chapter3.presentation.statistics import ORDER, Slope
from rgbd_dic_processing.validation.chapter3.quality import autocorrelation_radius
from rgbd_dic_processing.validation.chapter3.shots import CAMERA, REFERENCES, all_shots, crack_shots, moving_shots
from rgbd_dic_processing.validation.chapter3.tasks import SUBSET
from rgbd_dic_processing.validation.chapter3.thesis import printed_camera, printed_references


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("chapter3")


@pytest.fixture(scope="module")
def quick(folder):
    """What `rgbd-dic validate chapter3 --quick` measures."""
    return run_chapter3(folder, QUICK)


@pytest.mark.timeout(600)
def test_quick_run_reaches_the_numbers_asked_for(quick, folder):
    """Every number that the quick run can tell; the limits are those asked for, with the reasons in the docs."""
    reached = write_chapter3(quick, folder / "pages", folder)
    assert len(reached) >= 12
    assert [one for one in reached if not one.met] == []


@pytest.mark.parametrize("method, limit_mm", [("h_3d", 4e-4), ("pc_3d", 4e-4), ("h_pose", 1e-3), ("h_2d", 2e-3)])
def test_averages_are_the_truth(quick, method, limit_mm):
    """Band-limited, 8 bit, true K: also the crack of 50 mm."""
    assert np.abs(quick.errors("blobs", "8 bit", method, shots=QUICK.shots)).max() <= limit_mm


def test_geometry_is_exact(quick):
    """Not rounded there is no noise to hide behind; what is left is the interpolation."""
    for method in ORDER:
        assert np.abs(quick.errors("blobs", "unrounded", method, shots=QUICK.shots)).max() <= 1e-4


def test_affine_subsets_have_the_bias_of_the_thesis(quick):
    """Without second-order maps a yaw 20 degrees from the reference is off by as much as the thesis' worst average."""
    affine = abs(quick.errors("disks", "affine", "h_3d", references=(2,), shots=(11,)).item())
    assert 0.008 < affine < 0.03
    assert abs(quick.errors("disks", "8 bit", "h_3d", references=(2,), shots=(11,)).item()) < affine / 10


def test_wrong_focal_length_is_an_error_of_scale(quick):
    """Eq. 3.1 has 637.24 px for 640 px: 0.43 % of the crack."""
    fifty = quick.errors("blobs", "printed", "h_2d", shots=(41,))
    np.testing.assert_allclose(fifty, 50 * (640 / 637.24 - 1), atol=0.02)


def test_budget_adds_up(quick):
    for parts in quick.budget.values():
        together = np.sqrt(parts["rounding"] ** 2 + parts["aliasing"] ** 2 + parts["interpolation"] ** 2)
        np.testing.assert_allclose(together, parts["total"], rtol=0.1)


def test_subsets_state_an_honest_uncertainty(quick):
    for results in quick.noisy.values():
        within, of = (sum(result[name] for result in results.values()) for name in ("within", "of"))
        assert 0.93 <= within / of <= 0.97


def test_distortion_leaves_no_bias_with_maps_of_each_plate(quick):
    """k1 = -0.2, to 30 degrees of yaw; the limit is that of the undistorted images."""
    steps = quick.oblique["yaw", "k1 = -0.2"]
    assert [step["value"] for step in steps if "methods" in step] == QUICK.series["yaw"]  # none was lost
    for step in steps:
        assert abs(step["each plate"]["h_3d"]["opening"] - 10) <= 4e-4


def test_calibration_finds_the_camera(quick):
    """Within four standard uncertainties that it states itself."""
    true = np.array([640, 640, 639.5, 359.5, 0, 0])
    assert np.all(np.abs(quick.calibration["values"] - true) <= 4 * np.array(quick.calibration["sigma"]))


def test_a_second_run_measures_nothing_anew(quick, folder):
    before = {path: path.stat().st_mtime_ns for path in (folder / "cache").iterdir()}
    again = run_chapter3(folder, QUICK)
    assert {path: path.stat().st_mtime_ns for path in (folder / "cache").iterdir()} == before
    assert repr(again) == repr(quick)


def test_tables_have_the_thesis_beside_ours(quick, folder):
    write_chapter3(quick, folder / "pages", folder)
    text = (folder / "pages" / "tables" / "thesis.md").read_text()
    assert re.findall(r"\*\*Table (3\.\d+)\*\*", text) == ["3.3", "3.4", "3.7", "3.8"]
    assert "10.0018 ± 0.0151" in text  # thesis, Table 3.7, H 2D
    averages = quick.values("blobs", "8 bit", "h_3d", references=(0,))[0]
    assert f"{averages.mean():.4f} ± {averages.std(ddof=1):.4f}" in text


def test_every_printed_table_is_there():
    assert [number for one in printed_references() for number in one.tables] == [f"3.{n}" for n in range(3, 17)]
    for one in printed_references():
        for quantity, limits in one.extremes.items():
            for method, (low, high) in limits.items():  # Table 3.10 has 0.0032 and 0.0031, as printed
                assert low < high or (one.tables[1], quantity, method) == ("3.10", "rms_error", "h_2d")
        for method, (mean, _) in one.final.items():
            low, high = one.extremes["average"][method]
            assert low < mean < high
    assert (printed_camera().cx, printed_camera().fy) == (639.5, 640.08)


def test_the_full_run_has_the_images_of_the_thesis():
    assert len(FULL.references) == 7 and len(FULL.moving) == 30 and len(FULL.growing) == 10 and FULL.views == 28
    for series in ("yaw", "pitch", "roll"):
        angles = sorted(shot.angle_deg for shot in moving_shots() if shot.series == series)
        assert angles == [-15, -12, -9, -6, -3, 3, 6, 9, 12, 15]
    others = [shot.orientation_deg for shot in moving_shots() if shot.series != "yaw"]
    assert all(sorted(np.abs(angles))[1] <= 2 or 3 in np.abs(angles) for angles in others)
    assert [shot.crack_mm for shot in crack_shots()] == [2, 5, 10, 20, 50] * 2


@pytest.mark.parametrize("shot", [*REFERENCES, *all_shots().values()], ids=lambda shot: f"{shot.number:04d}")
def test_the_panel_is_wholly_in_view(shot):
    """In every pose of the thesis too: the angles are read as they were meant."""
    corners = project(shot, np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]), shot.crack_mm * 1e-3)
    assert np.all((corners >= 0) & (corners <= [CAMERA.width - 1, CAMERA.height - 1]))


def test_boards_are_in_view():
    corners = np.column_stack([BOARD.corners_m, np.zeros(len(BOARD.corners_m))])
    seen = []
    for pose in (thesis_pose(*view) for view in board_poses()):
        seen.append(CAMERA.project(corners @ pose.R.T + pose.t))
    assert len(seen) == 28
    every = np.concatenate(seen)
    assert np.all(every.min(axis=0) < [120, 60]) and np.all(every.max(axis=0) > [1160, 660])  # all over the image


def test_truth_of_a_pixel():
    """A pixel of the reference, followed by hand through the two poses."""
    base, view = REFERENCES[3], all_shots()[20]
    centres = np.array([[450.0, 300.0], [800.0, 500.0]])
    for pixel, seen in zip(centres, true_px(base, view, centres), strict=True):
        ray = base.pose.R.T @ np.array([(pixel[0] - 639.5) / 640, (pixel[1] - 359.5) / 640, 1])
        origin = -base.pose.R.T @ base.pose.t
        point = origin - ray * origin[2] / ray[2]
        point[0] += 0.010 * (point[0] > 0)
        at = view.pose.R @ point + view.pose.t
        np.testing.assert_allclose(seen, 640 * at[:2] / at[2] + [639.5, 359.5], atol=1e-9)


def test_scale_of_a_pixel():
    shot = REFERENCES[4]
    middle = project(shot, np.array([[-1e-3, 0.0]]))
    np.testing.assert_allclose(panel_per_pixel(shot, middle)[0] @ pixels_per_m(shot), np.eye(2), atol=1e-5)


def test_subsets_touch_no_edge():
    """All subsets of the measuring zones lie on one plate, at least seven pixels from its edges."""
    for shot in REFERENCES:
        regions = panel_regions(shot, SUBSET)
        centres = regions.subset_centres(CAMERA.width, CAMERA.height, SUBSET, 10).astype(float)
        for zone, sign in zip(regions.crack.members(centres), (-1, 1), strict=True):
            assert len(zone) > 1000
            half = SUBSET / 2 + 7
            corners = np.concatenate([centres[zone] + half * np.array(s) for s in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
            plane = exact_plane(shot)
            material = (plane.points(CAMERA.rays(corners)) - shot.pose.t) @ shot.pose.R
            assert np.all(material[:, 0] * sign > 0) and np.all(np.abs(material[:, :2]) < 0.5)


def test_slope_and_its_interval():
    random = np.random.default_rng(1)
    x = np.linspace(-15, 15, 10)
    slopes = [Slope.of(x, 0.2 * x + random.normal(0, 1, 10)) for _ in range(400)]
    covered = np.mean([abs(slope.value - 0.2) <= slope.half_width for slope in slopes])
    assert 0.92 < covered < 0.98
    assert not Slope.of(x, x + random.normal(0, 0.1, 10)).is_zero


def test_autocorrelation_radius_of_blobs():
    """Gaussian blobs of sigma s: the autocorrelation is a Gaussian of sigma s sqrt(2), half at s sqrt(4 ln 2)."""
    random = np.random.default_rng(2)
    spectrum = np.fft.fft2(random.normal(size=(256, 256)))
    frequency = np.fft.fftfreq(256)
    sigma = 2.0
    blur = np.exp(-2 * (np.pi * sigma) ** 2 * (frequency[:, None] ** 2 + frequency[None, :] ** 2))
    radius = autocorrelation_radius(np.fft.ifft2(spectrum * blur).real)
    assert radius == pytest.approx(sigma * np.sqrt(4 * np.log(2)), rel=0.05)


def test_other_settings_are_other_tasks(folder, quick):
    """A shot with another camera is another picture."""
    shot = all_shots()[11]
    assert shot.as_dict() != replace(shot, camera=replace(CAMERA, k1=-0.1)).as_dict()
