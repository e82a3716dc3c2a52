"""What a run keeps of its images and ToF frames: offsets, correlation, residuals of the planes; spells of validity."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Calibration, Camera
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_processing.core.correlation import SubsetStatus
from rgbd_dic_processing.core.frame_quality import QualityRecord, plane_quality
from rgbd_dic_processing.core.opening_budget import OpeningBudget
from rgbd_dic_processing.core.pairing import FramePairing
from rgbd_dic_processing.core.plane import PanelPlane
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.settings import PairingSettings, PlaneSettings
from rgbd_dic_processing.core.spells import gaps_of, spells_of
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import SubsetField
from rgbd_dic_processing.frame_files import FrameRecords

MS = 1_000_000


def field(stamp_ns: int, zncc: np.ndarray, found: np.ndarray) -> SubsetField:
    lost = SubsetField.without_subsets(stamp_ns, 0, 0, FrameStatus.OK, "", len(zncc), 31)
    status = np.where(found, SubsetStatus.CONVERGED, SubsetStatus.LOW_CORRELATION).astype(np.uint8)
    sigma = np.full((len(zncc), 2), 0.003, np.float32)
    return replace(lost, zncc=zncc.astype(np.float32), subset_status=status, sigma_px=sigma)


def test_correlation_is_that_of_the_subsets_that_were_found() -> None:
    """Of 201 found subsets, ZNCC evenly from 0.8 to 1: the median is 0.9, the 5th percentile 0.81."""
    zncc = np.append(np.linspace(0.8, 1.0, 201), np.full(99, 0.1))
    record = QualityRecord()
    record.add(field(5, zncc, zncc > 0.5))
    record.add(field(6, zncc, zncc > 2))
    some, none = record.images()
    assert (some.subsets, some.found) == (300, 201)
    assert (some.zncc_median, some.zncc_low) == pytest.approx((0.9, 0.81), abs=1e-6)  # float32
    assert some.sigma_px == pytest.approx(0.003, rel=1e-6)
    assert none.found == 0 and math.isnan(none.zncc_median + none.zncc_low + none.sigma_px)


def test_offsets_are_those_of_the_clocks() -> None:
    """60 images a second and 20 ToF frames, 7 ms later: the offsets repeat as -7, 9.7 and -23.7 ms. One ToF frame is
    missing; after a jump back of both clocks the same stamps come again, with other offsets."""
    pairing, record = FramePairing(PairingSettings()), QualityRecord()
    expected = []
    for depth_ms in (7, 3):
        images = [round(k * 50 / 3 * MS) for k in range(60)]
        depths = [(50 * k + depth_ms) * MS for k in range(20) if k != 10]
        for stamp, is_image in sorted([(s, True) for s in images] + [(s, False) for s in depths]):
            pairs = pairing.add_image(stamp) if is_image else pairing.add_depth(stamp)
            record.add(field(stamp, np.ones(3), np.ones(3, bool)) if is_image else None, pairs)
        for stamp in images:
            nearest = min(depths, key=lambda depth: abs(depth - stamp))
            near = abs(stamp - nearest) <= 30 * MS
            expected.append((stamp - nearest) * 1e-9 if near else math.nan)
    record.add(None, pairing.flush())
    found = [image.depth_offset_s for image in record.images()]
    assert found[:3] == pytest.approx([-7e-3, 9.6667e-3, -23.6667e-3], abs=1e-6)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.isnan(found).sum() > 0


def test_residual_distance_and_tilt_are_those_of_the_points() -> None:
    """A plane 1.5 m away, turned by 10 degrees about the vertical, with 4 mm of noise along z: from n points the RMS is
    known to 1 / sqrt(2 n), and three of that are allowed; Tukey's weights leave out next to nothing of normal noise."""
    camera = Camera(640, 480, 800.0, 800.0, 319.5, 239.5)
    regions = Regions(panel=np.array([(40.0, 40), (600, 40), (600, 440), (40, 440)]), fixed=(), x_axis=None, crack=None)
    planes = PanelPlane(Calibration(camera, camera), regions, PlaneSettings())
    planes.add_view(0, np.eye(3))
    normal = np.array([math.sin(math.radians(10)), 0.0, math.cos(math.radians(10))])
    rays = camera.rays(np.stack(np.meshgrid(np.arange(45.0, 600, 6), np.arange(45.0, 440, 6)), axis=-1).reshape(-1, 2))
    points = rays * (1.5 / (rays @ normal))[:, None]
    points[:, 2] += np.random.default_rng(1).normal(0, 4e-3, len(points))
    (estimate,) = [*planes.add_points(0, points), *planes.flush()]
    quality = plane_quality(estimate)
    assert quality.status == FrameStatus.OK and quality.points >= quality.inliers > 0.99 * quality.points
    assert quality.residual_rms_m == pytest.approx(4e-3, rel=3 / math.sqrt(2 * quality.points))
    assert quality.distance_m == pytest.approx(1.5, abs=1e-3)
    assert math.degrees(quality.tilt_rad) == pytest.approx(10, abs=0.1)


def test_files_give_back_what_was_written(tmp_path: Path) -> None:
    record = QualityRecord()
    record.add(field(5, np.linspace(0.8, 1, 20), np.ones(20, bool)))
    parts = np.array([4e-12, 1e-12, -0.5e-12, 0, 0, 2e-12, 0, 1e-14])
    budget = OpeningBudget(5, "h_pose", math.sqrt(parts.sum()), parts, 0.02)
    kept = FrameRecords(record.images(), [], [budget])
    kept.save(tmp_path)
    read = FrameRecords.load(tmp_path)
    assert read.images[0].zncc_median == pytest.approx(kept.images[0].zncc_median, abs=1e-6)
    assert math.isnan(read.images[0].depth_offset_s) and read.images[0].seed == kept.images[0].seed
    # a tenth of a nanometre is what the file keeps of a standard uncertainty of micrometres
    np.testing.assert_allclose(read.budgets[0].parts_m2, parts, atol=2 * 2e-6 * 0.5e-10)
    assert read.budgets[0].parts_m2.sum() == pytest.approx(read.budgets[0].u_opening_m ** 2, rel=1e-3)
    assert not FrameRecords.load(tmp_path / "older").images
    (tmp_path / "planes.csv").write_text("stamp_ns,other\n1,2\n")
    with pytest.raises(RgbdDicError, match="its columns are not"):
        FrameRecords.load(tmp_path)


def test_spells_and_gaps() -> None:
    """Frames every 0.1 s, none for 1 s after the tenth; states 0 and 3."""
    time = np.concatenate([np.arange(10) * 0.1, 1.9 + np.arange(5) * 0.1])
    states = np.array([0] * 4 + [3] * 6 + [3] * 2 + [0] * 3)
    spells = spells_of(time, states)
    assert [(s.state, s.frames) for s in spells] == [(0, 4), (3, 6), (3, 2), (0, 3)]
    assert [(s.begin_s, s.end_s) for s in spells[1:3]] == [pytest.approx((0.35, 0.95)), pytest.approx((1.85, 2.05))]
    assert gaps_of(time) == [pytest.approx((0.95, 1.85))]
    assert spells_of(np.zeros(0), np.zeros(0, int)) == [] and gaps_of(np.zeros(1)) == []
    assert spells_of(np.array([2.0]), np.array([1]))[0].frames == 1
