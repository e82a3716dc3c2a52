"""Exact geometry in, exact opening out: every method, on oblique views, with distortion and non-square pixels."""

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.compensation.motion import misfit_of
from rgbd_dic_processing.core.crack import CrackMeasurement
from rgbd_dic_processing.core.displacement import SOLVERS, DisplacementMeasurement
from rgbd_dic_processing.core.settings import CompensationSettings, CrackSettings
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
