"""The parts of the uncertainty of an opening: they add up, and each answers to its own cause alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.crack import CrackMeasurement, CrackOpening
from rgbd_dic_processing.core.displacement import SOLVERS, DisplacementMeasurement
from rgbd_dic_processing.core.error_sources import ErrorSource
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.plane import PlaneEstimate
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings
from scenes import ExactScene, pair, pose

CAMERA = Camera(640, 480, 820.0, 820.0, 319.5, 239.5)
SCENE = ExactScene(CAMERA, *pose((3, -5, 2), (0.0, 0.0, 1.0)))
MOVED = pose((5, -2, 3), (0.03, -0.02, 1.05))
JUMP = np.array([0.6e-3, 0.2e-3, 0.0])
CRACK = CrackMeasurement(CAMERA, SCENE.regions.crack, CrackSettings())
PLANE_COVARIANCE = np.diag([1e-3, 1e-3, 3e-4]) ** 2  # of the inverse depth [1/m]^2
NOISE = (ErrorSource.SUBSETS, ErrorSource.MOTION, ErrorSource.OVERLAP)


def uncertain(estimate: PlaneEstimate, times: float) -> PlaneEstimate:
    return replace(estimate, plane=Plane.from_inverse_depth(estimate.plane.inverse_depth, times * PLANE_COVARIANCE))


def parts(
    method: str, noise: float = 1.0, reference: float = 1.0, frame: float = 1.0, jump: np.ndarray = JUMP
) -> tuple[CrackOpening, np.ndarray]:
    """Of one exact frame, its variances multiplied: of the subsets, of the reference's plane and of the frame's."""
    step = DisplacementMeasurement(CAMERA, SCENE.regions, CompensationSettings(method=method, bow_m=0.0))
    step.set_reference(SCENE.reference)
    step.add_pair(pair(1))
    step.add_plane(uncertain(SCENE.estimate(1, SCENE.R, SCENE.t), reference))
    step.add_field(SCENE.field(1, SCENE.R, SCENE.t, 0 * jump))
    exact = SCENE.field(2, *MOVED, jump)
    step.add_pair(pair(2))
    step.add_plane(uncertain(SCENE.estimate(2, *MOVED), frame))
    sigma = np.full_like(exact.sigma_px, 0.02 * np.sqrt(noise))
    (field,) = step.add_field(replace(exact, sigma_px=sigma))
    return CRACK.measure_with_parts(field)


@pytest.mark.parametrize("method", SOLVERS)
def test_parts_add_up_to_the_stated_variance(method: str) -> None:
    opening, found = parts(method)
    assert opening.valid, opening.reason
    assert found.sum() == pytest.approx(opening.u_opening_m**2, rel=1e-12)
    assert (np.delete(found, ErrorSource.OVERLAP) >= 0).all()
    assert found[ErrorSource.SUBSETS] > 0 and found[ErrorSource.MOTION] > 0 and found[ErrorSource.SCALE] > 0


OCCURRING = {
    "h_pose": {ErrorSource.REFERENCE_PLANE},
    "h_joint": {ErrorSource.DEFORMATION},
    "h_3d": {ErrorSource.REFERENCE_PLANE, ErrorSource.FRAME_PLANE},
    "h_2d": set(),
    "pc_3d": {ErrorSource.REFERENCE_PLANE, ErrorSource.FRAME_PLANE},
}


@pytest.mark.parametrize("method", SOLVERS)
def test_each_method_has_the_sources_that_it_rests_on(method: str) -> None:
    _, found = parts(method)
    beside = {source for source in ErrorSource if found[source] > 0} - {*NOISE, ErrorSource.SCALE}
    assert beside == OCCURRING[method]


@pytest.mark.parametrize("method", ["h_pose", "h_3d", "h_2d", "pc_3d"])
def test_noise_of_the_subsets_moves_its_own_parts_alone(method: str) -> None:
    """Four times the variance of every subset makes its three parts four times as large: to 1 %, as the errors are
    differences over a whole standard deviation. The rest stays as it is, to the fifth digit, where the fit ends."""
    (_, once), (_, four) = parts(method), parts(method, noise=4.0)
    np.testing.assert_allclose(four[list(NOISE)], 4 * once[list(NOISE)], rtol=1e-2)
    others = [source for source in ErrorSource if source not in NOISE]
    np.testing.assert_allclose(four[others], once[others], rtol=1e-4, atol=1e-18)


@pytest.mark.parametrize("method", ["h_3d", "pc_3d"])
def test_noise_of_the_plane_in_the_image_moves_its_own_part_alone(method: str) -> None:
    (_, once), (_, four) = parts(method), parts(method, frame=4.0)
    assert four[ErrorSource.FRAME_PLANE] == pytest.approx(4 * once[ErrorSource.FRAME_PLANE], rel=1e-2)
    others = [source for source in ErrorSource if source != ErrorSource.FRAME_PLANE]
    np.testing.assert_allclose(four[others], once[others], rtol=1e-9, atol=1e-18)


def test_scale_is_the_uncertainty_of_the_distance_times_the_opening() -> None:
    """Half of the opening has half of it; h_2d takes nothing but its scale from the planes."""
    (whole, by_whole), (half, by_half) = parts("h_2d"), parts("h_2d", jump=JUMP / 2)
    assert by_half[ErrorSource.SCALE] == pytest.approx(by_whole[ErrorSource.SCALE] / 4, rel=1e-3)
    assert half.opening_m == pytest.approx(whole.opening_m / 2, rel=1e-3)
