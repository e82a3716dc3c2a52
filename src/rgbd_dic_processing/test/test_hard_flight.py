"""A short hard flight: turns to 15 degrees and a roll to 30, a bar in front, drops, changed exposures, a gap, a ToF
clock that is 40 ms late. Truth is exact."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.validation.chapter4.hard_flight import HEADER, HardFlight, fly

SHORT = {  # all of the ten seconds in three, at a third of the images
    "duration_s": 3.0,
    "orbit": {"frequency_hz": 0.35},
    "obstacle": {"start_s": 0.5, "crossing_s": 1.0},
    "camera": {"scale": 0.5, "exposure_every_s": 0.4},
    "tof": {"scale": 0.5},
    "loss": {"gap_start_s": 1.6, "gap_s": 0.5},
    "timing": {"camera_rate_hz": 20.0, "tof_rate_hz": 20.0},
    "deformation": {"field": "rigid_half"},
}


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> dict[float, HardFlight]:
    """By the `bow_m` that the panel is believed to have."""
    laboratory = Laboratory(laboratory_settings("laboratory_hard", SHORT))
    path = tmp_path_factory.mktemp("hard") / "regions.yaml"
    path.write_text(yaml.safe_dump(laboratory.regions))
    made = {}
    for bow_m in (0.001, 0.0):
        settings = ProcessingSettings.from_mapping({"compensation": {"bow_m": bow_m}})
        made[bow_m] = fly(laboratory, load_regions(path), settings, ("h_pose",))["h_pose"]
    return made


def test_every_visible_frame_is_measured(flight: dict[float, HardFlight]) -> None:
    """The first of them wait for the first ToF frame. At half the size an opening is only known to 0.008 mm; of some
    40 frames, whose errors share that of the one reference image, none is off by four times that."""
    seen = flight[0.001]
    assert seen.visible.sum() > 35 and not np.any(seen.visible[3:] & ~seen.valid[3:])
    error = seen.error_m[seen.visible & seen.valid]
    assert np.abs(error).max() < 0.032e-3
    stated = seen.u_m[seen.visible & seen.valid]
    assert np.sqrt(np.mean(error**2)) < 2 * np.sqrt(np.mean(stated**2))


def test_a_panel_taken_for_flat_is_worse(flight: dict[float, HardFlight]) -> None:
    """0.8 mm of bow, seen under 15 degrees, look like opening."""
    rms = {bow_m: np.sqrt(np.nanmean(one.error_m[one.visible] ** 2)) for bow_m, one in flight.items()}
    assert rms[0.0] > 2 * rms[0.001]


def test_hidden_zones_are_flagged(flight: dict[float, HardFlight]) -> None:
    seen = flight[0.001]
    hidden = [seen.openings[index] for index in np.flatnonzero(seen.hidden)]
    assert hidden and all(opening.status == FrameStatus.EMPTY_ZONE for opening in hidden)
    assert all("subsets in the" in opening.reason and np.isnan(opening.opening_m) for opening in hidden)
    partly = ~seen.visible & seen.valid
    assert np.all(np.abs(seen.error_m[partly]) < 4 * seen.u_m[partly])


def test_tracking_is_back_after_the_gap(flight: dict[float, HardFlight]) -> None:
    seen = flight[0.001]
    assert seen.frames_to_valid == 1
    assert len(seen.row()) == len(HEADER) - 3
