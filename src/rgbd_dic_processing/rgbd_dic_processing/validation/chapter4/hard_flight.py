"""A flight with everything that can go wrong, frame by frame against what is visible and true."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings

from ...core.correlation import CorrelationSettings
from ...core.crack import CrackOpening
from ...core.pipeline import Pipeline
from ...core.regions import Regions
from ...core.regions_file import load_regions
from ...core.settings import ProcessingSettings
from .errors import rms

Array = NDArray[np.float64]
START_NS = 10**9
HEADER = (
    "field",
    "method",
    "seed",
    "frames",
    "visible",
    "of them valid",
    "largest error [mm]",
    "RMS error [mm]",
    "stated, RMS [mm]",
    "hidden",
    "of them flagged",
    "frames to the first valid one after the gap",
)


@dataclass(frozen=True)
class HardFlight:
    """One method's openings of a hard flight.

    openings: one a frame. error_m: (n,), against the exact opening between the very subsets of the zones; NaN where
    not valid. left, right: (n,), share of the zone that the bar hides. after_gap: number of the first frame after the
    longest time without one.
    """

    openings: list[CrackOpening]
    error_m: Array
    left: Array
    right: Array
    after_gap: int

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(n,), frames in which the bar touches no subset of either zone."""
        return (self.left == 0) & (self.right == 0)

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """(n,), frames in which it touches every subset of one zone."""
        return (self.left == 1) | (self.right == 1)

    @property
    def valid(self) -> NDArray[np.bool_]:
        return np.array([opening.valid for opening in self.openings])

    @property
    def u_m(self) -> Array:
        """(n,), stated standard uncertainty of the openings."""
        return np.array([opening.u_opening_m for opening in self.openings])

    @property
    def frames_to_valid(self) -> int:
        """1 if the first frame after the gap is valid."""
        return 1 + int(np.argmax(self.valid[self.after_gap :]))

    def errors_mm(self) -> tuple[float, float, float]:
        """Largest and RMS error of the frames whose zones are visible, and the RMS of what was stated of them."""
        shown = self.visible & self.valid
        error = self.error_m[shown]
        return tuple(1e3 * float(value) for value in (np.abs(error).max(), rms(error), rms(self.u_m[shown])))

    def row(self) -> list[str]:
        """Of a table under HEADER, without its first three columns."""
        return [
            *map(str, (len(self.openings), self.visible.sum(), (self.visible & self.valid).sum())),
            *(f"{number:.4f}" for number in self.errors_mm()),
            *map(str, (self.hidden.sum(), (self.hidden & ~self.valid).sum(), self.frames_to_valid)),
        ]


def hard_flight(folder: Path, field: str, method: str, seed: int, duration_s: float) -> dict[str, Any]:
    """A row of the table, and of the frames whose zones are visible the largest and the RMS error and what was stated
    [mm]; whether all hidden ones are flagged; how many frames after the gap the first valid one comes."""
    wanted = {"seed": seed, "duration_s": duration_s, "deformation": {"field": field}}
    laboratory = Laboratory(laboratory_settings("laboratory_hard", wanted))
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / "regions.yaml"
        path.write_text(yaml.safe_dump(laboratory.regions))
        regions = load_regions(path)
    flown = fly(laboratory, regions, ProcessingSettings(), (method,))[method]
    return {
        "row": [f"`{field}`", f"`{method}`", str(seed), *flown.row()],
        **dict(zip(("largest_mm", "rms_mm", "stated_mm"), flown.errors_mm(), strict=True)),
        "flagged": bool(not np.any(flown.hidden & flown.valid)),
        "frames_to_valid": flown.frames_to_valid,
    }


def fly(
    laboratory: Laboratory, regions: Regions, settings: ProcessingSettings, methods: tuple[str, ...]
) -> dict[str, HardFlight]:
    """Measure a laboratory from its first frame to its last, none of them kept; method -> what came of it."""
    pipeline = Pipeline(laboratory.calibration, regions, settings, methods)
    times: dict[int, float] = {}
    measured = []
    for frame in laboratory.exposures():
        stamp_ns = START_NS + frame.stamp_ns
        if frame.sensor == "camera":
            times[stamp_ns] = frame.time_s
            measured += pipeline.add_image(stamp_ns, laboratory.image(frame.time_s, frame.index))
        else:
            measured += pipeline.add_depth(stamp_ns, laboratory.depth(frame.time_s, frame.index).depth_m)
    measured += pipeline.flush()
    drawn = pipeline.tracking.reference.drawn_px
    material = laboratory.material(drawn, laboratory.reference_s)
    left, right = (material[zone] for zone in regions.crack.members(drawn))
    sides = [
        [np.mean(_hidden(laboratory, side, t, settings.correlation)) for t in times.values()] for side in (left, right)
    ]
    truth = np.array([laboratory.crack(t, (left, right)).opening_m for t in times.values()])
    flights = {}
    for method in methods:
        openings = [one.opening for one in measured if one.field.method == method]
        error = np.array([opening.opening_m for opening in openings]) - truth
        gap = int(np.argmax(np.diff(list(times.values())))) + 1
        flights[method] = HardFlight(openings, error, np.array(sides[0]), np.array(sides[1]), gap)
    return flights


def _hidden(laboratory: Laboratory, material: Array, time_s: float, settings: CorrelationSettings) -> NDArray[np.bool_]:
    """(N,), whether the bar covers some of the subset at each material point (N, 2)."""
    s, moment = laboratory.settings, laboratory.moment(time_s)
    if moment.bar_m is None:
        return np.zeros(len(material), bool)
    eye = -moment.pose.R.T @ moment.pose.t
    x_m = eye[0] + (material[:, 0] - eye[0]) * (1 + s.obstacle.distance_m / eye[2])  # on the ray, in the bar's plane
    beside_m = settings.subset_size / 2 * s.motion.distance_m / laboratory.calibration.camera.fx
    return (x_m > moment.bar_m[0] - beside_m) & (x_m < moment.bar_m[1] + beside_m)
