"""The simulated laboratory as a bag with all that belongs to it: truth, calibration, regions, the reference's CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from ..bag import BagWriter
from ..calibration import save_calibration
from .flight_bag import START_NS, FlightSummary, Progress, write_flight
from .ground_truth import HEADER
from .laboratory import Laboratory, LaboratorySettings

REFERENCE_FILE = "reference_3d_dic.csv"


def simulate_laboratory(
    settings: LaboratorySettings, out: Path | str, progress: Progress | None = None
) -> FlightSummary:
    """Write the bag `out`, in it truth.csv, calibration.yaml, regions.yaml, laboratory.yaml and the reference's CSV.

    Same settings, same bytes. The CSV counts its time from the start of the flight and is late by the `delay_s` that
    laboratory.yaml tells.

    Raises:
        BagError: `out` exists or cannot be written.
        RegionsError: a region would lie outside the first image.
    """
    laboratory = Laboratory(settings)
    regions = laboratory.regions
    with BagWriter(out, settings.compression) as bag:
        write_flight(laboratory, bag, progress)
    save_truth(laboratory, bag.path / "truth.csv")
    save_calibration(laboratory.calibration, bag.path / "calibration.yaml")
    laboratory.stereo.save(bag.path / REFERENCE_FILE)
    regions_text = "# Regions in pixels of the raw reference image, the first of the recording (docs/files.md).\n"
    _save(regions, regions_text, bag.path / "regions.yaml")
    truth = {
        "start_ns": START_NS,
        "reference_delay_s": laboratory.stereo.delay_s,
        "tof_delay_s": settings.loss.tof_delay_s,
        "tof_noise_m": laboratory.tof_model.noise_m,
        "settings": settings.as_dict(),
    }
    _save(truth, "# What made this recording; the delays are the true ones.\n", bag.path / "laboratory.yaml")
    return FlightSummary(bag.path, dict(bag.counts))


def save_truth(laboratory: Laboratory, path: Path) -> None:
    """truth.csv: one row an image. The opening of the zones, T_camera_panel, the stroke, the jump at the crack's middle
    [mm], and the motion during the exposure [px]."""
    header = f"{HEADER},stroke_mm,crack_opening_mm,crack_sliding_mm,crack_step_mm,motion_px"
    lines = [header]
    for exposed_ns in laboratory.camera_ticks().exposed_ns:
        time_s = exposed_ns * 1e-9
        crack, pose = laboratory.crack(time_s), laboratory.pose(time_s)
        before = [crack.opening_m, crack.sliding_m, crack.out_of_plane_m, *pose.t]
        after = [laboratory.stroke_m(time_s), *laboratory.jump(np.zeros(()), time_s)]
        quaternion = Rotation.from_matrix(pose.R).as_quat(canonical=True)
        columns = [str(START_NS + int(exposed_ns))]
        columns += [f"{1e3 * value:.9f}" for value in before] + [f"{value:.12f}" for value in quaternion]
        columns += [f"{1e3 * value:.9f}" for value in after]
        lines.append(",".join([*columns, f"{laboratory.camera_model.motion_px(time_s):.4f}"]))
    path.write_text("\n".join(lines) + "\n")


def _save(content: object, heading: str, path: Path) -> None:
    path.write_text(heading + yaml.safe_dump(content, sort_keys=False, default_flow_style=None))
