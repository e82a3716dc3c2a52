"""Whether the autopilot's attitude would help to find the panel again after a gap: the table of docs/method.md, Search.

    tools/run python tools/payload/measure_attitude_prior.py

Simulated flights are cut off for 0.2 to 2 s. The first image after that is sought twice: as ever, and with the panel
first expected where the turn of the camera between the two images, as an attitude tells it, would have moved it. The
camera's place on the vehicle is taken as known, which favours the attitude.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.ground_truth import project, scene_regions
from rgbd_dic_acquisition.simulator.motion import HandheldMotion
from rgbd_dic_processing.core import keyframe
from rgbd_dic_processing.core.correlation import CorrelationSettings
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.regions_file import regions_of
from rgbd_dic_processing.core.search import SubsetSearch
from rgbd_dic_processing.core.settings import SearchSettings
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.tracking import SubsetTracking
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
GAPS_S = (0.2, 0.5, 1.0, 2.0)
SWAYS_RAD = (0.01, 0.03, 0.1)  # RMS about each axis: a hand; a drone in wind; a drone thrown about
SWAY_M = 0.02
NOISE_RAD = 0.005  # of a turn told by an attitude, about each axis
RATE_HZ = 60.0
SIZE = {"width_px": 480, "height_px": 360, "supersampling": 2}
LEAST_IN_VIEW = 0.25
BEFORE = 3  # images before the gap


class PriorSearch(SubsetSearch):
    """The search with one guess more, before all others. turned: (3, 3), camera before the gap -> after it."""

    turned: Array | None = None

    def _candidates(self, stamp_ns: int, image: NDArray[np.uint8]) -> Iterator[tuple[Array | None, str]]:
        if PriorSearch.turned is not None:
            K = self._camera.matrix
            view = K @ PriorSearch.turned @ np.linalg.inv(K) @ self._prediction.last
            view = view / view[2, 2]
            yield view, "attitude"
            yield self._matched(*self._coarse.jumped(image, view, self._centres[self._probes])), "attitude, coarse"
        for homography, source in super()._candidates(stamp_ns, image):
            yield homography, source.name.lower()


class StillSourced(SubsetTracking):
    """A tracking that takes any name for the source of a guess."""

    last_source = ""

    def _field(self, stamp_ns, found):
        if isinstance(found.source, str):
            self.last_source = found.source
            found = replace(found, source=0)
        return super()._field(stamp_ns, found)


@dataclass(frozen=True)
class Tried:
    found: bool
    source: str
    cpu_ms: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=12, help="of each kind (default: %(default)s)")
    flights = parser.parse_args().flights
    keyframe.SubsetSearch = PriorSearch
    cv2.setNumThreads(1)
    print(
        "| turns, RMS about each axis [degrees] | gap [s] | turned in it, median [degrees] | found, as ever | with it |"
        " CPU time, as ever, mean (longest) [ms] | with it | by features, as ever | with it |"
    )
    print("|---" * 9 + "|")
    for sway in SWAYS_RAD:
        still, flight = _flight(0.0, 0.0), _flight(SWAY_M, sway)
        reference, regions = still.image(0.0, 0), regions_of(scene_regions(still, 0.0))
        for gap in GAPS_S:
            rows = [
                row
                for seed in range(1, flights + 1)
                if (row := _case(flight, gap, seed, reference, regions)) is not None
            ]
            print(_line(sway, gap, rows), flush=True)


def _flight(sway_m: float, sway_rad: float) -> Flight:
    settings = {"duration_s": 60.0, "camera": SIZE, "motion": {"sway_m": sway_m, "sway_rad": sway_rad}}
    return Flight(FlightSettings.from_mapping(settings), workers=1)


def _case(
    flight: Flight, gap: float, seed: int, reference: NDArray[np.uint8], regions: Regions
) -> tuple[float, Tried, Tried] | None:
    """How far the camera turned [degrees], and both ways; None if the panel is not there to be found."""
    flight._motion = HandheldMotion(flight.settings.motion, np.random.default_rng(seed))
    camera, start_s = flight.calibration.camera, 1.0 + 0.37 * seed
    before_s = [start_s - k / RATE_HZ for k in reversed(range(BEFORE))]
    last_s, next_s = before_s[-1], before_s[-1] + gap
    if min(_in_view(flight, time_s) for time_s in (last_s, next_s)) < LEAST_IN_VIEW:
        return None
    images = [(round(time_s * 1e9), flight.image(time_s, index)) for index, time_s in enumerate((*before_s, next_s))]
    turned = flight.pose(next_s).R @ flight.pose(last_s).R.T
    error = Rotation.from_rotvec(NOISE_RAD * np.random.default_rng(seed).standard_normal(3)).as_matrix()
    degrees = float(np.degrees(Rotation.from_matrix(turned).magnitude()))
    tried = []
    for prior in (None, error @ turned):
        tracking = StillSourced(camera, regions, CorrelationSettings(threads=1), SearchSettings())
        PriorSearch.turned = None
        tracking.track(1, reference)
        fields = [tracking.track(stamp, image) for stamp, image in images[:-1]]
        if fields[-1].status != FrameStatus.OK:
            return None
        PriorSearch.turned, began = prior, time.process_time()
        field = tracking.track(*images[-1])
        cpu_ms = 1e3 * (time.process_time() - began)
        found = field.status == FrameStatus.OK
        tried.append(Tried(found, tracking.last_source if found else "none", cpu_ms))
    return degrees, *tried


def _in_view(flight: Flight, time_s: float) -> float:
    """Share of the panel that is in the image."""
    panel, camera = flight.scene.settings, flight.calibration.camera
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 21) * panel.width_m, np.linspace(-0.5, 0.5, 21) * panel.height_m)
    px = project(flight, np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), time_s)
    return float(np.mean(((px >= 0) & (px <= (camera.width - 1, camera.height - 1))).all(axis=1)))


def _line(sway: float, gap: float, rows: list[tuple[float, Tried, Tried]]) -> str:
    """A row of the table: first as ever, then with the attitude."""
    degrees, *sides = zip(*rows, strict=True)
    cells = [f"{np.degrees(sway):.1f}", f"{gap:g}", f"{np.median(degrees):.1f}"]
    cells += [f"{sum(each.found for each in side)} of {len(side)}" for side in sides]
    times = [[each.cpu_ms for each in side] for side in sides]
    cells += [f"{np.mean(each):.0f} ({max(each):.0f})" for each in times]
    cells += [str(sum(each.source == "features" for each in side)) for side in sides]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
