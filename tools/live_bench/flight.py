"""The flight that is played: full-size images and depth frames of the simulated laboratory, rendered once and kept."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import save_calibration
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_processing.core.correlation import CorrelationSettings
from rgbd_dic_processing.core.layout import SubsetLayout
from rgbd_dic_processing.core.regions_file import load_regions

RATE_HZ, EVERY = 60.0, 3  # images a second; images for one depth frame
LAST = 90  # number of the last image: there the flight turns round, a multiple of EVERY / 2
PHASE = 0.44  # of the depth frames, in image periods after an image
SETTINGS = {"seed": 1, "duration_s": (LAST + 2) / RATE_HZ, "deformation": {"field": "rigid_half"}}
LARGER = 1.02  # the panel's region than the laboratory draws it, so that it holds 1,500 subsets
AREA_PX = 1270 * 600 * LARGER**2  # of that region


@dataclass(frozen=True)
class Flight:
    """Frames in the order of a flight that goes to its last image and back, and so on.

    images: (LAST + 1, rows, cols) uint8. depths: (n, rows, cols) uint16 [mm].
    """

    folder: Path
    images: NDArray[np.uint8]
    depths: NDArray[np.uint16]

    @property
    def calibration(self) -> Path:
        return self.folder / "calibration.yaml"

    @property
    def regions(self) -> Path:
        return self.folder / "regions.yaml"


def image_index(tick: int) -> int:
    """Which image comes at a tick."""
    back = tick % (2 * LAST)
    return min(back, 2 * LAST - back)


def depth_index(number: int) -> int:
    """Which depth frame is the so-manieth to come."""
    return number % (2 * LAST // EVERY)


def step_for(subsets: int) -> int:
    """Distance between subsets [px] at which the panel holds at least so many."""
    return math.floor(math.sqrt(AREA_PX / subsets))


def flight(folder: Path) -> Flight:
    """The flight kept in a folder, rendered if it is not there: 45 s of one core, 200 MB."""
    kept = folder / "flight.npz"
    if not kept.exists():
        _render(folder, kept)
    with np.load(kept) as stored:
        return Flight(folder, stored["images"], stored["depths"])


def true_opening_m(played: Flight, correlation: CorrelationSettings) -> NDArray[np.float64]:
    """(LAST + 1,) [m] for each image, of the very subsets that a measurement averages."""
    lab = Laboratory(laboratory_settings("laboratory", SETTINGS))
    regions = load_regions(played.regions)
    subsets = SubsetLayout(lab.calibration.camera, regions, correlation).drawn_px
    zones = tuple(lab.material(subsets[zone], lab.reference_s) for zone in regions.crack.members(subsets))
    return np.array([lab.crack(time_s, zones).opening_m for time_s in _times(lab)])


def _times(lab: Laboratory) -> NDArray[np.float64]:
    return lab.reference_s + np.arange(LAST + 1) / RATE_HZ


def _render(folder: Path, kept: Path) -> None:
    print("rendering the flight, once", flush=True)
    lab = Laboratory(laboratory_settings("laboratory", SETTINGS))
    ticks = np.arange(PHASE, 2 * LAST, EVERY)
    places = np.where(ticks <= LAST, ticks, 2 * LAST - ticks)
    depths = [lab.depth(lab.reference_s + place / RATE_HZ, number).depth_m for number, place in enumerate(places)]
    folder.mkdir(parents=True, exist_ok=True)
    panel = np.array(lab.regions["panel"])
    larger = panel.mean(axis=0) + LARGER * (panel - panel.mean(axis=0))
    (folder / "regions.yaml").write_text(yaml.safe_dump({**lab.regions, "panel": larger.round(2).tolist()}))
    save_calibration(lab.calibration, folder / "calibration.yaml")
    unfinished = kept.with_suffix(".part.npz")
    np.savez(
        unfinished,
        images=np.array([lab.image(time_s, index) for index, time_s in enumerate(_times(lab))]),
        depths=np.rint(np.nan_to_num(np.array(depths)) * 1e3).astype(np.uint16),
    )
    unfinished.replace(kept)
