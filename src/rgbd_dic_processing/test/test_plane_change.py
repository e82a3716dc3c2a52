"""How the ToF sensor saw the panel's plane move, and what h_joint makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_processing.core.displacement import DisplacementMeasurement
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.pairing import FramePair
from rgbd_dic_processing.core.plane import PlaneEstimate
from rgbd_dic_processing.core.plane_change import SLOPE_LENGTH_M, PlaneChanges
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.sensor_delay import SensorDelay
from rgbd_dic_processing.core.settings import CompensationSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import Reference
from rgbd_dic_processing.validation.chapter4.measuring import map_error_m
from scenes import pose
from scipy.spatial.transform import Rotation
from test_h_joint import NOISE_PX, SUBSET, subset_field

PLANE = Plane.from_inverse_depth(np.array([0.02, -0.03, 0.45]))
X, Y = np.meshgrid(np.linspace(-0.27, 0.27, 25), np.linspace(-0.14, 0.14, 13))
RAYS = np.column_stack([X.ravel(), Y.ravel(), np.ones(X.size)])
NOISE = np.diag([5e-5, 8e-5, 1e-5]) ** 2  # of a ToF plane: 0.1 and 0.2 mrad, 0.05 mm
FRAME_NS = 16_666_667
STEP_PX, STEP_NS = 40, 50_000_000  # of the flight below


def swaying(time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A hand's motion of a centimetre and half a degree."""
    w = 2 * np.pi * time_s
    turn = 0.008 * np.array([np.sin(w), np.sin(1.3 * w), np.sin(0.7 * w)])
    return Rotation.from_rotvec(turn).as_matrix(), 0.01 * np.array([np.sin(0.9 * w), np.sin(1.7 * w), np.sin(1.1 * w)])


def seen_at(time_s: float) -> Plane:
    return Plane.from_inverse_depth(PLANE.moved(*swaying(time_s)).inverse_depth, NOISE)


def flown(turned_rad: float = 0.0, late_s: float = 0.0, known: SensorDelay | None = None):
    """Changes in the last of 90 images. From half a second on, deformation turns the poses of the images about x by
    turned_rad; before, it is told that it did not."""
    changes = PlaneChanges(RAYS, 0.03, lambda _: known or SensorDelay(reason="not known"))
    for k in range(90):
        time_s, stamp = k * FRAME_NS * 1e-9, k * FRAME_NS
        if k % 3 == 1:
            changes.add(stamp + round((0.004 + late_s) * 1e9), seen_at(stamp * 1e-9 + 0.004))
        R, t = swaying(time_s)
        deformed = time_s > 0.5
        if deformed:
            R = Rotation.from_rotvec([turned_rad, 0, 0]).as_matrix() @ R
        covariance = np.diag([1e-5, 1e-5, 1e-7, 1e-6, 1e-6, 1e-5]) ** 2 * (1e4 if deformed else 1)
        change = changes.at_image(stamp, (R, t), covariance, covariance)
    return change, (R, t)


def test_turn_that_deformation_looks_like() -> None:
    """The planes are exact; left is how the spline rings beside the jump of the poses, a fiftieth of it (0.04 mrad)."""
    change, (R, t) = flown(turned_rad=2e-3)
    true = PLANE.moved(*swaying(89 * FRAME_NS * 1e-9)).inverse_depth
    np.testing.assert_allclose(change.reference, PLANE.inverse_depth, atol=2e-5)
    np.testing.assert_allclose(change.image, true, atol=1e-5)
    off = PLANE.moved(R, t).inverse_depth - change.image
    assert abs(off[1]) > 5e-4  # 2 mrad of a plane 2.2 m away


def test_delay_that_is_known_and_one_that_is_not() -> None:
    """In 40 ms the hand turns by 2 mrad. A known delay is taken off, an unknown one is in the uncertainty."""
    true = PLANE.moved(*swaying(89 * FRAME_NS * 1e-9)).inverse_depth
    known, _ = flown(late_s=0.04, known=SensorDelay(0.04, 1e-4, 20))
    np.testing.assert_allclose(known.image, true, atol=2e-5)
    unknown, _ = flown(late_s=0.04)
    off, sigma = unknown.image - true, np.sqrt(np.diag(unknown.covariance))
    assert np.abs(off[:2]).max() > 1e-4
    assert np.all(np.abs(off) < 3 * sigma)
    assert np.all(sigma > np.sqrt(np.diag(known.covariance)))


def test_error_of_the_sensor_is_covered() -> None:
    """The spread of the change over 400 random error functions of the distance, for a motion of centimetres; the
    standard deviation of as many is known to 4 %."""
    moved, random = pose((5, -8, 3), (0.03, 0.01, 0.02)), np.random.default_rng(3)
    changes = PlaneChanges(RAYS, 0.03, lambda _: SensorDelay())
    stated = changes._of_sensor(PLANE, moved)
    before = PLANE.points(RAYS)
    after = before @ moved[0].T + moved[1]
    nodes = np.arange(1.7, 2.8, 0.01)
    kernel = 0.003**2 * np.exp(-0.5 * ((nodes[:, None] - nodes) / SLOPE_LENGTH_M) ** 2)
    factor = np.linalg.cholesky(kernel + 1e-12 * np.eye(len(nodes)))
    off = []
    for _ in range(400):
        error = factor @ random.standard_normal(len(nodes))
        seen = [fitted(points, np.interp(np.linalg.norm(points, axis=1), nodes, error)) for points in (before, after)]
        off.append(seen[1] - Plane.from_inverse_depth(seen[0]).moved(*moved).inverse_depth)
    np.testing.assert_allclose(np.std(off, axis=0), np.sqrt(np.diag(stated)), rtol=0.2)


def fitted(points: np.ndarray, error_m: np.ndarray) -> np.ndarray:
    """pi of the plane through points (M, 3) that are seen too far along their rays by error_m (M,)."""
    seen = points * (1 + error_m / np.linalg.norm(points, axis=1))[:, None]
    z = seen[:, 2]
    weighted = seen * z[:, None]
    return np.linalg.lstsq(weighted, z, rcond=None)[0]


@pytest.mark.parametrize("field", ["beam", "plate"])
def test_map_of_a_panel_without_a_rigid_part(field, tmp_path) -> None:
    """Over a second of loading, with what a ToF sensor does: a wiggle of 2 mm over 0.375 m, noise of a plane as above.
    Asked are 0.02 px; the image alone does not tell bending from a turn of the camera, and leaves twice as much. The
    panel stays in its plane."""
    deformation = {"field": field, "bulge": 0.0}
    lab = Laboratory(laboratory_settings("laboratory", {"seed": 3, "deformation": deformation}))
    asked, alone = (map_rms_px(lab, slope, tmp_path) for slope in (0.03, 1.0))
    assert asked.max() < 0.02
    assert alone.max() > 1.2 * asked.max()


def test_map_of_a_panel_that_bulges(tmp_path) -> None:
    """Its middle comes 0.2 mm nearer; taken for strain, that is an error of 0.03 px. A panel that does not bulge is
    measured as well."""
    lab, flat = (
        Laboratory(laboratory_settings("laboratory", {"seed": 3, "deformation": {"field": "plate", **bulge}}))
        for bulge in ({}, {"bulge": 0.0})
    )
    told, untold = (map_rms_px(lab, 0.03, tmp_path, bulge_m=bulge_m) for bulge_m in (0.0005, 0.0))
    assert told.max() < 0.02
    assert untold.max() > 1.5 * told.max()
    assert map_rms_px(flat, 0.03, tmp_path).max() < 0.02


def map_rms_px(lab: Laboratory, slope: float, tmp_path, **settings) -> np.ndarray:
    """(2,): of the maps of h_joint from 1 to 2 s, at exact positions with the noise of the DIC."""
    (tmp_path / "regions.yaml").write_text(yaml.safe_dump(lab.regions))
    regions, camera = replace(load_regions(tmp_path / "regions.yaml"), fixed=()), lab.calibration.camera
    centres = regions.subset_centres(camera.width, camera.height, SUBSET, STEP_PX).astype(float)
    start = lab.reference_s
    material = lab.material(centres, start)
    centres, material = centres[np.isfinite(material[:, 0])], material[np.isfinite(material[:, 0])]
    step = DisplacementMeasurement(camera, regions, CompensationSettings(method="h_joint", tof_slope=slope, **settings))
    step.set_reference(Reference.first(0, np.zeros((camera.height, camera.width), np.uint8), centres, SUBSET, STEP_PX))
    random, squared = np.random.default_rng(7), []
    on_panel = np.column_stack([material, np.zeros(len(material))])
    for k in range(40):
        time_s, stamp = start + k * STEP_NS * 1e-9, k * STEP_NS
        moved = lab.project(*material.T, time_s) + (NOISE_PX * random.standard_normal(centres.shape) if k else 0)
        points = on_panel @ lab.pose(time_s).R.T + lab.pose(time_s).t
        wiggle = 0.002 * np.sin(2 * np.pi * np.linalg.norm(points, axis=1) / 0.375)
        seen = fitted(points, wiggle) + np.sqrt(np.diag(NOISE)) * random.standard_normal(3)
        step.add_pair(FramePair(stamp, stamp))
        plane = Plane.from_inverse_depth(seen, NOISE)
        step.add_plane(PlaneEstimate(stamp, FrameStatus.OK, "", plane, 1000, 1000, 1e-3))
        (field,) = step.add_field(subset_field(stamp, camera, centres, moved))
        assert field.status == FrameStatus.OK, field.reason
        if k >= 20:
            error = map_error_m(field, lab.displacement(*material.T, time_s), regions)
            squared.append(np.nanmean(error**2, axis=0))
    return np.sqrt(np.mean(squared, axis=0)) / (lab.settings.motion.distance_m / camera.fx)
