"""A simulated flight that real protocols carry: what the fake sensors show, and what is true of it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from gige_peers import sent
from rgbd_dic_acquisition.calibration import save_calibration
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.ground_truth import save_regions
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.graph import GraphFiles

SHOWN_HZ = 20.0  # how often there is a new image
SETTINGS = {"seed": 3, "duration_s": 1.0, "timing": {"camera_rate_hz": SHOWN_HZ}}
COUNT = 21
EXPOSURE_NS = 100_000


@cache
def _flight() -> Flight:
    return Flight(FlightSettings.from_mapping(SETTINGS))


@cache
def _images() -> np.ndarray:
    return np.stack([_flight().image(index / SHOWN_HZ, index) for index in range(COUNT)])


@cache
def _depth_frames() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    frames = [_flight().depth(index / SHOWN_HZ, index) for index in range(COUNT)]
    return [(frame.depth_m, frame.intensity, frame.confidence) for frame in frames]


class ShownCrack:
    """One second of flight as 21 images, shown there and back; its calibration.yaml and regions.yaml in a folder.

    Attributes:
        images: (21, rows, cols) uint8.
        rms_limit_m: of the opening, as for the demonstration.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.flight, self.images = _flight(), _images()
        self.files = GraphFiles(folder / "calibration.yaml", folder / "regions.yaml")
        save_calibration(self.flight.calibration, self.files.calibration)
        save_regions(self.flight, 0.0, self.files.regions)
        self.rms_limit_m = 0.02 * self.flight.pose(0.0).t[2] / self.flight.calibration.camera.fx

    def depth_frames(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Depth [m], intensity and confidence at the moments of the images."""
        return _depth_frames()

    def errors_m(self, openings: list[CrackOpening]) -> np.ndarray:
        """Of openings through a camera of `gige_peers`, which logged what it sent into the folder."""
        host_ns, index = sent(self._folder)[:, 1], sent(self._folder)[:, 3]

        def truth_m(stamp_ns: int) -> float:
            """Of the image that was shown at the nearest time."""
            nearest = np.argmin(np.abs(host_ns - (stamp_ns - EXPOSURE_NS // 2)))
            assert abs(host_ns[nearest] - stamp_ns) < 5e6
            return self.flight.crack(index[nearest] / SHOWN_HZ).opening_m

        return np.array([o.opening_m - truth_m(o.stamp_ns) + truth_m(o.reference_stamp_ns) for o in openings])
