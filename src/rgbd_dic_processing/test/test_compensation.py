"""Exact geometry in, exact opening out: every method, on oblique views, with distortion and non-square pixels."""

import dataclasses

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.compensation.motion import misfit_of
from rgbd_dic_processing.core.crack import CrackMeasurement
from rgbd_dic_processing.core.displacement import SOLVERS, DisplacementMeasurement
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings
from rgbd_dic_processing.core.status import FrameStatus
from scenes import ExactScene, pair, pose

CAMERA = Camera(640, 480, 820.0, 835.0, 322.0, 236.5, -0.12, 0.05)
REFERENCES = [
    pose((0, 0, 0), (0, 0, 1.0)),
    pose((8, -12, 25), (0.02, -0.01, 1.1)),
    pose((-20, 15, -170), (0, 0, 0.9)),
]
MOVED = pose((6, 9, -14), (0.05, -0.03, 1.07))


@pytest.mark.parametrize("method", SOLVERS)
@pytest.mark.parametrize("reference", REFERENCES)
def test_opening_is_exact(method, reference):
    scene = ExactScene(CAMERA, *reference)
    step = DisplacementMeasurement(CAMERA, scene.regions, CompensationSettings(method=method))
    crack = CrackMeasurement(CAMERA, scene.regions.crack, CrackSettings())
    jump = np.array([0.8e-3, 0.3e-3, 0.0])
    R, t = MOVED[0] @ reference[0], MOVED[0] @ reference[1] + [0.03, 0.02, -0.05]
    step.set_reference(scene.reference)
    openings = []
    for stamp, (rotation, translation), shift in ((1, reference, 0 * jump), (2, (R, t), jump)):
        step.add_pair(pair(stamp))
        step.add_plane(scene.estimate(stamp, rotation, translation))
        openings += [crack.measure(f) for f in step.add_field(scene.field(stamp, rotation, translation, shift))]
    first, second = openings
    assert first.valid and second.valid, (first.reason, second.reason)
    assert first.opening_m == pytest.approx(0, abs=1e-10)
    assert second.opening_m == pytest.approx(jump[0], abs=1e-9)
    assert second.sliding_m == pytest.approx(jump[1], abs=1e-9)


@pytest.mark.parametrize("shift_px", [(0.3, 0.3), (1.0, 0.9), (-8.0, 7.0)])
def test_misfit_of_residuals_in_any_direction(shift_px) -> None:
    """All residuals alike, and oblique: the misfit that makes their median length that of a normal distribution."""
    residual = np.tile(shift_px, (20, 1))
    misfit_px = misfit_of(residual, np.full((20, 2), 0.005))
    lengths = np.linalg.norm(residual / np.hypot(0.005, misfit_px), axis=1)
    np.testing.assert_allclose(lengths, 1.1774, rtol=1e-3)


@pytest.mark.parametrize("misfit_px", [0.003, 0.05])
def test_misfit_makes_the_median_length_what_it_should_be(misfit_px: float) -> None:
    """For an odd number of residuals to the last bits: the median one is as long as it should be."""
    random = np.random.default_rng(1)
    sigma_px = random.uniform(0.001, 0.01, (501, 2))
    residual = random.normal(size=(501, 2)) * np.hypot(sigma_px, misfit_px)
    found_px = misfit_of(residual, sigma_px)
    lengths = np.linalg.norm(residual / np.hypot(sigma_px, found_px), axis=1)
    assert np.median(lengths) == pytest.approx(1.1774, rel=1e-9)
    assert found_px == pytest.approx(misfit_px, rel=0.15)  # three standard deviations of such a median


def test_no_misfit_where_the_uncertainty_tells_all() -> None:
    residual = np.random.default_rng(1).normal(size=(500, 2)) * 0.004
    assert misfit_of(residual, np.full((500, 2), 0.005)) == 0
    assert misfit_of(np.zeros((500, 2)), np.full((500, 2), 0.005)) == 0


def half_hidden(share: float):
    """A frame whose right zone turns and stretches, and hides its lower part; its opening, and that of the whole."""
    scene = ExactScene(CAMERA, *REFERENCES[0])
    step = DisplacementMeasurement(CAMERA, scene.regions, CompensationSettings())
    step.set_reference(scene.reference)
    step.add_pair(pair(1))
    step.add_plane(scene.estimate(1, *REFERENCES[0]))
    (field,) = step.add_field(scene.field(1, *REFERENCES[0], np.zeros(3)))
    x, y = field.position_m.T
    displacement = np.column_stack([0.001 + 0.004 * y, 0.002 * x - 0.004 * y, 0 * x]) * (x > 0)[:, None]
    whole = dataclasses.replace(field, displacement_m=displacement)
    _, right = scene.regions.crack.members(field.centres_px)
    hidden = right[y[right] > np.quantile(y[right], 1 - share)]
    partly = whole.displacement_m.copy()
    partly[hidden] = np.nan
    crack = CrackMeasurement(CAMERA, scene.regions.crack, CrackSettings())
    return crack.measure(dataclasses.replace(whole, displacement_m=partly)), crack.measure(whole)


def test_a_half_hidden_zone_counts_as_if_it_was_whole() -> None:
    """What was found is continued linearly, and stated to be less certain; the mean of it would be off by 0.1 mm."""
    partly, whole = half_hidden(0.4)
    assert partly.n_right < 0.7 * whole.n_right
    assert partly.opening_m == pytest.approx(whole.opening_m, abs=1e-9)
    assert partly.sliding_m == pytest.approx(whole.sliding_m, abs=1e-9)
    assert partly.u_opening_m > 1.1 * whole.u_opening_m


def test_a_hidden_zone_is_not_measured() -> None:
    hidden, _ = half_hidden(0.6)
    assert hidden.status == FrameStatus.EMPTY_ZONE and np.isnan(hidden.opening_m)
    assert "right zone" in hidden.reason and "at least" in hidden.reason
