"""The stated uncertainty of the opening against what noise really does, and the correlation of overlapping subsets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.crack import CrackMeasurement
from rgbd_dic_processing.core.displacement import SOLVERS, DisplacementMeasurement
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.uncertainty import independent_modes, overlap_correlation, quadratic_terms
from scenes import SUBSET, ExactScene, pair, pose

CAMERA = Camera(640, 480, 820.0, 820.0, 319.5, 239.5)
SCENE = ExactScene(CAMERA, *pose((3, -5, 2), (0.0, 0.0, 1.0)))
MOVED = pose((5, -2, 3), (0.03, -0.02, 1.05))
SIGMA_PX = 0.02
PLANE_SIGMA = np.diag([1e-3, 1e-3, 3e-4]) ** 2  # of the inverse depth [1/m]^2


def test_overlap_correlation_is_that_of_white_noise() -> None:
    """The means of white noise over overlapping subsets correlate as the share of pixels they have in common; 4,000
    noise images know a correlation to 0.016 (one standard deviation)."""
    centres = np.array([(20, 20), (27, 20), (27, 31), (51, 20)])
    expected = overlap_correlation(centres, 21).toarray()
    noise = np.random.default_rng(1).standard_normal((4000, 60, 80))
    means = [noise[:, y - 10 : y + 11, x - 10 : x + 11].mean(axis=(1, 2)) for x, y in centres]
    np.testing.assert_allclose(np.corrcoef(means), expected, atol=0.06)
    assert expected[0, 3] == 0 and expected[0, 1] == pytest.approx(14 / 21)


def test_independent_modes_make_up_the_covariance() -> None:
    factor = np.random.default_rng(2).normal(size=(5, 3))
    covariance = factor @ factor.T  # rank 3
    modes = independent_modes(covariance)
    assert modes.shape == (3, 5)
    np.testing.assert_allclose(modes.T @ modes, covariance, atol=1e-12)


def test_quadratic_terms() -> None:
    np.testing.assert_allclose(quadratic_terms(np.array([[2.0, 3.0]])), [[1, 2, 3, 4, 6, 9]])


def correlated_noise(random: np.random.Generator, centres: np.ndarray) -> np.ndarray:
    """(N, 2) errors of subsets as white image noise makes them: box means of a white field."""
    fields = random.standard_normal((2, CAMERA.height + SUBSET, CAMERA.width + SUBSET))
    sums = np.pad(fields.cumsum(axis=1).cumsum(axis=2), ((0, 0), (1, 0), (1, 0)))
    x, y = centres.T
    total = sums[:, y + SUBSET, x + SUBSET] - sums[:, y, x + SUBSET] - sums[:, y + SUBSET, x] + sums[:, y, x]
    return SIGMA_PX * total.T / SUBSET


@pytest.mark.parametrize("method", SOLVERS)
def test_stated_uncertainty_of_the_opening(method: str) -> None:
    """Over 120 frames with noise in the subsets and in this frame's plane, the error divided by the stated
    uncertainty has a standard deviation of 1; from 120 frames it is known to 6.5 %, so 20 % is three of that.

    The reference plane is exact: its error is common to all frames of a flight."""
    random = np.random.default_rng(3)
    settings = CompensationSettings(method=method)
    crack = CrackMeasurement(CAMERA, SCENE.regions.crack, CrackSettings())
    jump = np.array([0.6e-3, 0.2e-3, 0.0])
    exact = SCENE.field(2, *MOVED, jump)
    truth = SCENE.estimate(2, *MOVED)
    ratios = []
    for _ in range(120):
        step = DisplacementMeasurement(CAMERA, SCENE.regions, settings)
        step.set_reference(SCENE.reference)
        step.add_pair(pair(1))
        step.add_plane(SCENE.estimate(1, SCENE.R, SCENE.t))
        step.add_field(SCENE.field(1, SCENE.R, SCENE.t, 0 * jump))
        noisy = replace(
            exact,
            moved_px=exact.moved_px + correlated_noise(random, SCENE.reference.centres_px),
            sigma_px=np.full_like(exact.sigma_px, SIGMA_PX),
        )
        pi = random.multivariate_normal(truth.plane.inverse_depth, PLANE_SIGMA)
        step.add_pair(pair(2))
        step.add_plane(replace(truth, plane=Plane.from_inverse_depth(pi, PLANE_SIGMA)))
        (field,) = step.add_field(noisy)
        opening = crack.measure(field)
        assert opening.valid, opening.reason
        ratios.append(
            (
                (opening.opening_m - jump[0]) / opening.u_opening_m,
                (opening.sliding_m - jump[1]) / opening.u_sliding_m,
            )
        )
    assert np.std(ratios, axis=0) == pytest.approx(np.ones(2), abs=0.2)
    assert np.abs(np.mean(ratios, axis=0)).max() < 0.35


def test_one_zone_out_of_sight_is_not_a_measurement() -> None:
    step = DisplacementMeasurement(CAMERA, SCENE.regions, CompensationSettings())
    crack = CrackMeasurement(CAMERA, SCENE.regions.crack, CrackSettings())
    step.set_reference(SCENE.reference)
    exact = SCENE.field(2, *MOVED, np.zeros(3))
    hidden = exact.moved_px.copy()
    hidden[SCENE.reference.centres_px[:, 0] > 330] = np.nan
    step.add_pair(pair(2))
    step.add_plane(SCENE.estimate(2, *MOVED))
    (field,) = step.add_field(replace(exact, moved_px=hidden))
    opening = crack.measure(field)
    assert opening.status == FrameStatus.EMPTY_ZONE and "in the right zone" in opening.reason
    assert np.isnan([opening.opening_m, opening.u_opening_m, opening.magnitude_m]).all()
    assert opening.n_left > 0 and opening.n_right == 0


def test_fixed_region_out_of_sight_is_not_a_measurement() -> None:
    step = DisplacementMeasurement(CAMERA, SCENE.regions, CompensationSettings())
    step.set_reference(SCENE.reference)
    exact = SCENE.field(2, *MOVED, np.zeros(3))
    step.add_pair(pair(2))
    step.add_plane(SCENE.estimate(2, *MOVED))
    (field,) = step.add_field(replace(exact, moved_px=np.full_like(exact.moved_px, np.nan)))
    assert field.status == FrameStatus.NO_FIXED_REGION and "at least 12 needed" in field.reason


def test_fixed_region_that_holds_the_crack_is_refused_by_h_pose() -> None:
    """A fixed region of which half moves by 5 mm: no pose fits it, and h_pose says so instead of averaging."""
    step = DisplacementMeasurement(CAMERA, replace(SCENE.regions, fixed=()), CompensationSettings())
    step.set_reference(SCENE.reference)
    step.add_pair(pair(2))
    step.add_plane(SCENE.estimate(2, *MOVED))
    (field,) = step.add_field(SCENE.field(2, *MOVED, np.array([5e-3, 0, 0])))
    assert field.status == FrameStatus.NOT_COMPENSATED and "unlike a rigid plane" in field.reason
