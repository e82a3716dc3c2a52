"""What the thesis printed of its chapter 3, for comparison."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import yaml
from rgbd_dic_acquisition.calibration import Camera

from .shots import CAMERA

DATA = Path(__file__).with_name("thesis.yaml")
QUANTITIES = {"average": "Average [mm]", "std_dev": "Std dev [mm]", "rms_error": "RMS error [mm]"}


@dataclass(frozen=True)
class PrintedReference:
    """Of one reference image, in mm.

    tables: numbers of the two tables. final: method -> (mean of the averages, their standard deviation).
    extremes: quantity -> method -> (smallest, largest of the images).
    """

    tables: tuple[str, str]
    final: dict[str, tuple[float, float]]
    extremes: dict[str, dict[str, tuple[float, float]]]


@functools.cache
def printed_references() -> tuple[PrintedReference, ...]:
    """Tables 3.3 to 3.16."""
    return tuple(PrintedReference(**entry) for entry in yaml.safe_load(DATA.read_text())["references"])


@functools.cache
def printed_camera() -> Camera:
    """Eq. 3.1, with the first pixel's centre at (0, 0)."""
    K = yaml.safe_load(DATA.read_text())["camera_matrix"]
    return Camera(CAMERA.width, CAMERA.height, K["fx"], K["fy"], K["cx"] - 1, K["cy"] - 1)
