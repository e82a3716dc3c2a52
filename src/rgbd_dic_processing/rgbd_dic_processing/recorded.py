"""Offline: a bag through the pipeline, with the code that the nodes run."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration, Camera, load_calibration
from rgbd_dic_acquisition.errors import BagError, CalibrationError, ImageError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import (
    CAMERA_INFO,
    IMAGE,
    POINT_CLOUD,
    depth_from_message,
    image_from_message,
    points_from_message,
)
from scipy.spatial.transform import Rotation

from .core.pipeline import Measurement, Pipeline

CAMERA_TOPIC, DEPTH_TOPIC, POINTS_TOPIC = "camera/image_raw", "tof/depth/image_raw", "tof/points"
CAMERA_INFO_TOPIC, TOF_INFO_TOPIC = "camera/camera_info", "tof/depth/camera_info"


def has_clouds(bag: BagReader) -> bool:
    """Whether the ToF frames of a bag are point clouds: it has `tof/points`, and no depth images."""
    names = {name.lstrip("/") for name in bag.topics}
    return POINTS_TOPIC in names and DEPTH_TOPIC not in names


def check_topics(bag: BagReader) -> None:
    """Refuse a bag that the graph could not measure.

    Raises:
        BagError: naming the missing topic and those that are there.
    """
    bag.require(CAMERA_TOPIC, IMAGE)
    bag.require(CAMERA_INFO_TOPIC, CAMERA_INFO)
    if has_clouds(bag):
        bag.require(POINTS_TOPIC, POINT_CLOUD)
    else:
        bag.require(DEPTH_TOPIC, IMAGE)
        bag.require(TOF_INFO_TOPIC, CAMERA_INFO)


def calibration_of(bag: BagReader, path: Path | None) -> Calibration:
    """calibration.yaml if a path is given; else the bag's camera_infos and /tf_static.

    Raises:
        CalibrationError: if the bag's cameras are uncalibrated or the extrinsics are missing.
    """
    if path is not None:
        return load_calibration(path)
    camera, camera_frame = _camera_of(bag, CAMERA_INFO_TOPIC)
    if has_clouds(bag):
        cloud = next((message for _, _, message in bag.messages([bag.require(POINTS_TOPIC, POINT_CLOUD)])), None)
        tof, tof_frame = None, cloud.header.frame_id if cloud is not None else ""
    else:
        tof, tof_frame = _camera_of(bag, TOF_INFO_TOPIC)
    return Calibration(camera, tof, *_extrinsics(bag, camera_frame, tof_frame))


def calibration_warning(bag: BagReader, calibration: Calibration) -> str:
    """What a user should know about a calibration that differs from the bag's camera_info; empty if it does not."""
    try:
        recorded, _ = _camera_of(bag, CAMERA_INFO_TOPIC)
    except (BagError, CalibrationError):
        return ""
    return (
        "" if recorded.agrees_with(calibration.camera) else "calibration differs from the bag's camera_info; it is used"
    )


def _camera_of(bag: BagReader, topic: str) -> tuple[Camera, str]:
    """A camera and its frame, from the first message of a camera_info topic."""
    name = bag.require(topic, CAMERA_INFO)
    info = next((message for _, _, message in bag.messages([name])), None)
    if info is None:
        raise BagError(f"{bag.path}: topic {name} is empty: give a calibration.yaml with --calibration")
    return Camera.from_camera_info(info), info.header.frame_id


def _extrinsics(bag: BagReader, camera_frame: str, tof_frame: str) -> tuple[NDArray, NDArray]:
    """R, t of X_camera = R X_tof + t [m] from the bag's /tf_static."""
    messages = bag.messages(["/tf_static"]) if "/tf_static" in bag.topics else ()
    for _, _, message in messages:
        for stamped in message.transforms:
            if (stamped.header.frame_id, stamped.child_frame_id) == (camera_frame, tof_frame):
                q, t = stamped.transform.rotation, stamped.transform.translation
                return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), np.array([t.x, t.y, t.z])
    raise CalibrationError(
        f"{bag.path} has no transform {camera_frame} -> {tof_frame} on /tf_static: give a calibration.yaml with "
        "--calibration"
    )


def measure_bag(bag: BagReader, pipeline: Pipeline) -> Iterator[list[Measurement]]:
    """Yields once per message of the two image topics what it settled, in the order of the bag; flushes at the end.

    A message that cannot be read becomes an invalid frame with its reason.
    """
    converters = {
        topic: (convert, add)
        for topic, convert, add in (
            (bag.require(CAMERA_TOPIC, IMAGE), image_from_message, pipeline.add_image),
            (
                (bag.require(POINTS_TOPIC, POINT_CLOUD), points_from_message, pipeline.add_points)
                if has_clouds(bag)
                else (bag.require(DEPTH_TOPIC, IMAGE), depth_from_message, pipeline.add_depth)
            ),
        )
    }
    for topic, kind, _, data in bag.raw_messages(converters):
        convert, add = converters[topic]
        try:
            content, reason = convert(bag.deserialise(kind, data)), ""
        except (BagError, ImageError) as error:
            content, reason = None, str(error)
        yield add(header_stamp_ns(data), content, reason)
    yield pipeline.flush()


def frame_count(bag: BagReader) -> int:
    """Messages that `measure_bag` will go through."""
    depth = (POINTS_TOPIC, POINT_CLOUD) if has_clouds(bag) else (DEPTH_TOPIC, IMAGE)
    return sum(bag.topics[bag.require(*topic)].count for topic in ((CAMERA_TOPIC, IMAGE), depth))
