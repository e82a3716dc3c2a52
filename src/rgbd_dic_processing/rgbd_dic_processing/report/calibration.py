"""The calibration of a run for its page: each number with its standard uncertainty, where it is known."""

from __future__ import annotations

import math
from pathlib import Path

import yaml
from rgbd_dic_acquisition.calibration import Calibration, load_calibration
from rgbd_dic_acquisition.errors import RgbdDicError
from scipy.spatial.transform import Rotation

from ..calibrating.summary import Row, row

CALIBRATION_NAME, ESTIMATES_NAME = "calibration.yaml", "estimates.yaml"
SAME = 1e-6  # relative difference up to which a number is the one that was estimated


def of_run(folder: Path) -> list[Row]:
    """One row for each number of calibration.yaml in a run's folder; none if there is no such file.

    The uncertainties are those of estimates.yaml, which `rgbd-dic calibrate` writes beside it, where the numbers are
    still those that were estimated.

    Raises:
        RgbdDicError: if one of the files cannot be read.
    """
    if not (folder / CALIBRATION_NAME).exists():
        return []
    sigmas = _sigmas(folder / ESTIMATES_NAME)
    rows = []
    for name, value in _numbers(load_calibration(folder / CALIBRATION_NAME)).items():
        estimated, sigma = sigmas.get(name, (math.nan, math.nan))
        same = abs(value - estimated) <= SAME * max(abs(value), abs(estimated)) + 1e-9
        rows.append(row(name, value, sigma if same else math.nan))
    return rows


def _numbers(calibration: Calibration) -> dict[str, float]:
    """By the names of estimates.yaml."""
    numbers: dict[str, float] = {}
    for sensor in ("camera", "tof"):
        lens = getattr(calibration, sensor)
        if lens is not None:
            numbers |= {f"{sensor}.{name}": getattr(lens, name) for name in ("fx", "fy", "cx", "cy", "k1", "k2")}
    if calibration.tof is not None:
        turn = Rotation.from_matrix(calibration.R_camera_tof).as_rotvec()
        numbers |= {f"T_camera_tof.about_{axis}": float(about) for axis, about in zip("xyz", turn, strict=True)}
        along = zip("xyz", calibration.t_camera_tof, strict=True)
        numbers |= {f"T_camera_tof.{axis}": float(value) for axis, value in along}
    return numbers


def _sigmas(path: Path) -> dict[str, tuple[float, float]]:
    """Name -> value and standard uncertainty."""
    if not path.exists():
        return {}
    try:
        entries = yaml.safe_load(path.read_text())["estimates"]
        return {name: (float(entry["value"]), float(entry["u"])) for name, entry in entries.items()}
    except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise RgbdDicError(f"{path} is not an estimates.yaml of rgbd-dic calibrate: {error!r}") from error
