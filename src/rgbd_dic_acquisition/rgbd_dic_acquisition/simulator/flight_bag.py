"""A simulated flight as a bag with all that belongs to it: truth, calibration and regions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from .. import messages
from ..bag import BagWriter, make_message
from ..calibration import save_calibration
from .flight import CAMERA_FRAME, TOF_FRAME, Flight, FlightSettings
from .ground_truth import save_regions, save_truth
from .motion import attitude

if TYPE_CHECKING:
    from .laboratory import Laboratory

START_NS = 1_750_000_000 * 10**9  # host time at which every simulated flight begins

TOPICS = {
    "/camera/image_raw": messages.IMAGE,
    "/camera/camera_info": messages.CAMERA_INFO,
    "/tof/depth/image_raw": messages.IMAGE,
    "/tof/depth/camera_info": messages.CAMERA_INFO,
    "/tof/intensity/image_raw": messages.IMAGE,
    "/tof/confidence/image_raw": messages.IMAGE,
    "/imu/data": messages.IMU,
    "/tf_static": messages.TF,
    "/crack_opening_truth": "rgbd_dic_msgs/msg/CrackOpening",
}

Progress = Callable[[int, int], None]
Outgoing = Iterator[tuple[str, Any]]


@dataclass(frozen=True)
class FlightSummary:
    """What was written: the bag's directory and the number of messages on each topic."""

    path: Path
    counts: dict[str, int]


def simulate_flight(settings: FlightSettings, out: Path | str, progress: Progress | None = None) -> FlightSummary:
    """Write the bag `out`, in it truth.csv, calibration.yaml and regions.yaml. Same settings, same bytes.

    Args:
        progress: called with (exposures done, exposures in all) after each.

    Raises:
        BagError: `out` exists or cannot be written.
        RegionsError: a region would lie outside the first image.
    """
    flight = Flight(settings)
    with BagWriter(out, settings.compression) as bag:
        write_flight(flight, bag, progress)
    exposures_ns = flight.camera_ticks().exposed_ns
    save_truth(flight, START_NS, exposures_ns, bag.path / "truth.csv")
    save_calibration(flight.calibration, bag.path / "calibration.yaml")
    save_regions(flight, exposures_ns[0] * 1e-9, bag.path / "regions.yaml")
    return FlightSummary(bag.path, dict(bag.counts))


def write_flight(flight: Flight | Laboratory, bag: BagWriter, progress: Progress | None = None) -> None:
    """All messages of a flight, as they arrive."""
    for topic, typename in TOPICS.items():
        bag.add_topic(topic, typename, transient_local=topic == "/tf_static")
    static = messages.transform_message(make_message, START_NS, flight.calibration, CAMERA_FRAME, TOF_FRAME)
    bag.write_message("/tf_static", START_NS, static)
    events = _events(flight)
    for done, (arrived_ns, exposed_ns, kind, index) in enumerate(events, start=1):
        for topic, message in _SENDERS[kind](flight, exposed_ns, index):
            bag.write_message(topic, START_NS + arrived_ns, message, START_NS + arrived_ns)
        if progress is not None:
            progress(done, len(events))


def _events(flight: Flight | Laboratory) -> list[tuple[int, int, str, int]]:
    """(arrival, exposure, sensor, number) of every exposure, in the order of arrival [ns since the start]."""
    streams = {"camera": flight.camera_ticks(), "imu": flight.imu_ticks(), "tof": flight.tof_ticks()}
    return sorted(
        (int(arrived), int(exposed), kind, index)
        for kind, stream in streams.items()
        for index, (exposed, arrived) in enumerate(zip(stream.exposed_ns, stream.arrived_ns, strict=True))
    )


def _camera_messages(flight: Flight | Laboratory, exposed_ns: int, index: int) -> Outgoing:
    stamp_ns, time_s = START_NS + exposed_ns, exposed_ns * 1e-9
    image = flight.image(time_s, index)
    yield "/camera/image_raw", messages.image_message(make_message, stamp_ns, CAMERA_FRAME, image, "mono8")
    info = messages.camera_info_message(make_message, stamp_ns, CAMERA_FRAME, flight.calibration.camera)
    yield "/camera/camera_info", info
    crack = flight.crack(time_s)
    components = np.array([crack.opening_m, crack.sliding_m, crack.out_of_plane_m])
    yield (
        "/crack_opening_truth",
        make_message(
            TOPICS["/crack_opening_truth"],
            header=messages.header_message(make_message, stamp_ns, "panel"),
            reference_stamp=messages.stamp_message(make_message, START_NS + int(flight.camera_ticks().exposed_ns[0])),
            valid=True,
            opening=crack.opening_m,
            sliding=crack.sliding_m,
            out_of_plane=crack.out_of_plane_m,
            magnitude=float(np.linalg.norm(components)),
            depth_offset=float("nan"),
            latency=float("nan"),
        ),
    )


def _tof_messages(flight: Flight | Laboratory, exposed_ns: int, index: int) -> Outgoing:
    stamp_ns = START_NS + exposed_ns + flight.tof_ticks().stamp_delay_ns
    frame = flight.depth(exposed_ns * 1e-9, index)
    yield (
        "/tof/depth/image_raw",
        messages.depth_message(make_message, stamp_ns, TOF_FRAME, frame.depth_m),
    )
    info = messages.camera_info_message(make_message, stamp_ns, TOF_FRAME, flight.tof_model.camera)
    yield "/tof/depth/camera_info", info
    for name, pixels in (("intensity", frame.intensity), ("confidence", frame.confidence)):
        image = messages.image_message(make_message, stamp_ns, TOF_FRAME, pixels, "mono16")
        yield f"/tof/{name}/image_raw", image


def _imu_messages(flight: Flight | Laboratory, exposed_ns: int, index: int) -> Outgoing:
    error = Rotation.from_rotvec(flight.attitude_error(index)).as_matrix()
    measured = Rotation.from_matrix(error @ attitude(flight.pose(exposed_ns * 1e-9)))
    variance = max(flight.settings.attitude_noise_rad**2, 1e-12)
    yield (
        "/imu/data",
        messages.imu_message(
            make_message,
            START_NS + exposed_ns,
            "base_link",
            measured.as_quat(canonical=True),
            variance * np.eye(3),
        ),
    )


_SENDERS: dict[str, Callable[[Any, int, int], Outgoing]] = {
    "camera": _camera_messages,
    "imu": _imu_messages,
    "tof": _tof_messages,
}
