"""The stated uncertainty of the opening against what noise really does, and the correlation of overlapping subsets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.crack import CrackMeasurement, CrackOpening
from rgbd_dic_processing.core.displacement import SOLVERS, DisplacementMeasurement
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.plane import PlaneEstimate
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import SubsetField
from rgbd_dic_processing.core.uncertainty import independent_modes, overlap_correlation, quadratic_terms
from scenes import SUBSET, ExactScene, pair, pose
from scipy.spatial.transform import Rotation

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
    x, y = centres.astype(int).T
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


def measured(steps: DisplacementMeasurement, field: SubsetField, planes: list[PlaneEstimate]) -> list[CrackOpening]:
    """The same field as one frame for each of these planes of its ToF frame."""
    crack = CrackMeasurement(CAMERA, SCENE.regions.crack, CrackSettings())
    openings = []
    for index, plane in enumerate(planes):
        stamp = 10 + index
        steps.add_pair(pair(stamp))
        steps.add_plane(replace(plane, stamp_ns=stamp))
        openings += [crack.measure(f) for f in steps.add_field(replace(field, stamp_ns=stamp))]
    return openings


def started(method: str = "h_pose", regions: Regions = SCENE.regions) -> DisplacementMeasurement:
    """With its reference set."""
    steps = DisplacementMeasurement(CAMERA, regions, CompensationSettings(method=method))
    steps.set_reference(SCENE.reference)
    return steps


def test_misfit_of_the_fixed_region_makes_the_opening_less_certain() -> None:
    """Noise five times what the DIC states, both zones inside the fixed region: the stated uncertainty follows."""
    random = np.random.default_rng(4)
    whole = replace(SCENE, crack_x_m=1.0)  # nothing moves
    regions = replace(SCENE.regions, fixed=())
    exact = whole.field(2, *MOVED, np.zeros(3))
    errors, stated = [], []
    for _ in range(60):
        steps = started(regions=regions)
        noise = 5 * correlated_noise(random, SCENE.reference.centres_px)
        noisy = replace(exact, moved_px=exact.moved_px + noise, sigma_px=np.full_like(exact.sigma_px, SIGMA_PX))
        (opening,) = measured(steps, noisy, [SCENE.estimate(2, *MOVED)])
        errors.append(opening.opening_m)
        stated.append(opening.u_opening_m)
    assert np.std(errors) / np.sqrt(np.mean(np.square(stated))) == pytest.approx(1, abs=0.3)


def tilted(degrees: float) -> PlaneEstimate:
    estimate = SCENE.estimate(2, *MOVED)
    R = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    return replace(estimate, plane=estimate.plane.moved(R, np.zeros(3)))


@pytest.mark.parametrize("method", ["h_pose", "h_2d"])
def test_one_bad_first_plane_is_outvoted(method: str) -> None:
    steps = started(method)
    exact = SCENE.field(2, *MOVED, np.array([1e-3, 0, 0]))
    opening = measured(steps, exact, [tilted(10)] + 5 * [SCENE.estimate(2, *MOVED)])[-1]
    assert opening.valid and opening.opening_m == pytest.approx(1e-3, abs=1e-6)


@pytest.mark.parametrize("method", ["h_3d", "pc_3d"])
def test_bad_plane_of_the_reference_is_refused_once_it_is_contradicted(method: str) -> None:
    steps = started(method)
    exact = SCENE.field(2, *MOVED, np.array([1e-3, 0, 0]))
    opening = measured(steps, exact, [tilted(10)] + 5 * [SCENE.estimate(2, *MOVED)])[-1]
    assert opening.status == FrameStatus.NOT_COMPENSATED and "contradicts" in opening.reason


@pytest.mark.parametrize("degrees", [75, 80, -88])
@pytest.mark.parametrize("method", SOLVERS)
def test_absurd_planes_never_raise(method: str, degrees: float) -> None:
    steps = started(method)
    exact = SCENE.field(2, *MOVED, np.zeros(3))
    openings = measured(steps, exact, [tilted(degrees)] + 4 * [SCENE.estimate(2, *MOVED)])
    assert len(openings) == 5
    assert all(o.valid or o.reason for o in openings)


@pytest.mark.parametrize("method", SOLVERS)
def test_one_subset_found_in_a_wrong_place_changes_nothing(method: str) -> None:
    steps = started(method)
    exact = SCENE.field(2, *MOVED, np.array([1e-3, 0, 0]))
    in_left_zone = SCENE.regions.crack.members(SCENE.reference.centres_px.astype(float))[0][5]
    moved = exact.moved_px.copy()
    moved[in_left_zone] += (25, -10)
    (opening,) = measured(steps, replace(exact, moved_px=moved), [SCENE.estimate(2, *MOVED)])
    assert opening.valid, opening.reason
    assert opening.opening_m == pytest.approx(1e-3, abs=3e-6)


def test_out_of_plane_step_counts_from_the_reference_or_not_at_all() -> None:
    exact, truth = SCENE.field(2, *MOVED, np.zeros(3)), SCENE.estimate(2, *MOVED)
    planes = [replace(truth, step_m=step, u_step_m=1e-4) for step in (1e-3, 1.5e-3)]
    late = measured(started("pc_3d"), exact, planes)
    assert np.isnan([o.out_of_plane_m for o in late]).all()  # none of them belongs to the reference
    steps = started("pc_3d")
    steps.add_pair(pair(1))
    steps.add_plane(replace(SCENE.estimate(1, SCENE.R, SCENE.t), step_m=2e-3, u_step_m=1e-4))
    steps.add_field(SCENE.field(1, SCENE.R, SCENE.t, np.zeros(3)))
    known = measured(steps, exact, planes)
    assert [o.out_of_plane_m for o in known] == pytest.approx([-1e-3, -0.5e-3], abs=1e-9)
    assert known[0].u_out_of_plane_m == pytest.approx(np.hypot(1e-4, 1e-4), rel=0.05)
