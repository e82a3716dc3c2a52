"""A flight in front of a crack, rendered to files before it is flown, so that the peers only play it.

They play it there and back by the host's clock, so that camera, ToF camera and autopilot show the same moment.
"""

from __future__ import annotations

import itertools
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import save_calibration
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.ground_truth import save_regions
from rgbd_dic_acquisition.simulator.motion import attitude
from scipy.spatial.transform import Rotation

IMAGE_RATE_HZ, TOF_RATE_HZ = 60.0, 20.0
# Aravis' fake camera exposes whenever the computer's time is a multiple of its period, in whole microseconds.
IMAGE_PERIOD_NS = 16_666_000
ATTITUDE_RATE_HZ = 10_000.0  # of the table; the autopilot sends fifty a second of them
DEPTH_STEP_M = 10e-3 / 65.536  # of Coord3D_C16: 10 m in 16 bits
# Aviation's axes in those of ROS: north-east-down in east-north-up, forward-right-down in forward-left-up.
R_NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
R_FLU_FRD = np.diag([1.0, -1.0, -1.0])


class RenderedFlight:
    """The files of one flight in a folder; those of the same settings are used again.

    Attributes:
        played_ns: from its first moment to its last.
        images, depth, attitude: images (N, rows, cols) uint8 as .npy; range, intensity and confidence
            (N, 3, rows, cols) uint16 without header; quaternions (N, 4) of forward-right-down in north-east-down.
    """

    def __init__(self, settings: FlightSettings, folder: Path) -> None:
        self.settings, self.folder = settings, folder
        self.image_count = round(settings.duration_s * IMAGE_RATE_HZ) + 1
        self.depth_count = round(settings.duration_s * TOF_RATE_HZ) + 1
        self.played_ns = (self.image_count - 1) * IMAGE_PERIOD_NS
        self.images, self.depth, self.attitude = (folder / name for name in ("images.npy", "depth.bin", "attitude.npy"))
        self.calibration, self.regions = folder / "calibration.yaml", folder / "regions.yaml"
        said = folder / "settings.yaml"
        text = yaml.safe_dump(settings.as_dict())
        if not said.exists() or said.read_text() != text:
            folder.mkdir(parents=True, exist_ok=True)
            self._render()
            said.write_text(text)

    @cached_property
    def flight(self) -> Flight:
        return Flight(self.settings)

    @cached_property
    def shown_images(self) -> NDArray[np.uint8]:
        return np.load(self.images, mmap_mode="r")

    @cached_property
    def shown_depth(self) -> NDArray[np.uint16]:
        tof = self.settings.tof
        return np.memmap(self.depth, "<u2", "r", shape=(self.depth_count, 3, tof.height_px, tof.width_px))

    def image_time_s(self, index: int) -> float:
        return index * self.played_ns * 1e-9 / (self.image_count - 1)

    def depth_time_s(self, index: int) -> float:
        return index * self.played_ns * 1e-9 / (self.depth_count - 1)

    def time_s(self, host_ns: int) -> float:
        """Of the flight, at a host time."""
        phase_ns = host_ns % (2 * self.played_ns)
        return min(phase_ns, 2 * self.played_ns - phase_ns) * 1e-9

    def _render(self) -> None:
        save_calibration(self.flight.calibration, self.calibration)
        save_regions(self.flight, 0.0, self.regions)
        camera, tof = self.settings.camera, self.settings.tof
        shape = (self.image_count, camera.height_px, camera.width_px)
        images = np.lib.format.open_memmap(self.images, "w+", np.uint8, shape)
        for index in range(self.image_count):
            images[index] = self.flight.image(self.image_time_s(index), index)
            if index % 20 == 0:
                print(f"rendering the flight: {index} of {self.image_count} images", flush=True)
        images.flush()
        shape = (self.depth_count, 3, tof.height_px, tof.width_px)
        depth = np.memmap(self.depth, "<u2", "w+", shape=shape)
        for index in range(self.depth_count):
            frame = self.flight.depth(self.depth_time_s(index), index)
            depth[index, 0] = np.rint(np.nan_to_num(frame.depth_m) / DEPTH_STEP_M)
            depth[index, 1], depth[index, 2] = frame.intensity, frame.confidence
        depth.flush()
        times = np.linspace(0, self.played_ns * 1e-9, round(self.settings.duration_s * ATTITUDE_RATE_HZ) + 1)
        R_ned_frd = R_NED_ENU @ np.array([attitude(self.flight.pose(time)) for time in times]) @ R_FLU_FRD
        np.save(self.attitude, _continuous(np.roll(Rotation.from_matrix(R_ned_frd).as_quat(), 1, axis=1)))


def _continuous(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """With the sign of each as of the one before."""
    signs = np.sign(np.sum(quaternions[1:] * quaternions[:-1], axis=1))
    return quaternions * np.array([1.0, *itertools.accumulate(signs, lambda a, b: a * b)])[:, None]
